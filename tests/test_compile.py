"""The cache of compiled kernels: never stale, and whole whoever writes it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

MODEL = Path(__file__).parents[1] / "model"

LAW = """
from demflow.model.compile import kernel

@kernel
def law(x):
    return 2 * x
"""

CALLER = """
from demflow.model.compile import kernel
from demflow.model.law import law

@kernel
def caller(x):
    return law(x)
"""

COMPILE = """
import sys, time
from numba.core import caching

save = caching.IndexDataCacheFile._save_index

def slowly(self, overloads):
    time.sleep(0.5)  # another process has all the time to come in between
    save(self, overloads)

caching.IndexDataCacheFile._save_index = slowly
from demflow.model.caller import caller
print("ready", flush=True)
sys.stdin.readline()
assert caller(eval(sys.argv[1])) == 2 * eval(sys.argv[1])
"""


def small_model(folder: Path) -> dict[str, str]:
    """A package of two kernels under the model's own policy; the environment to import it."""
    package = folder / "model"
    package.mkdir()
    (package / "__init__.py").touch()
    for name in ("compile.py", "compilation.py"):
        shutil.copy(MODEL / name, package)
    (package / "law.py").write_text(LAW)
    (package / "caller.py").write_text(CALLER)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    environment["PYTHONPATH"] = str(folder)
    environment.pop("NUMBA_DISABLE_JIT", None)
    return environment


def answer(code: str, folder: Path, environment: dict[str, str]) -> str:
    run = [sys.executable, "-c", code]
    done = subprocess.run(
        run, env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_a_changed_law_is_never_answered_from_the_cache(tmp_path):
    environment = small_model(tmp_path)
    code = "from model.caller import caller; print(caller(1.5))"
    assert answer(code, tmp_path, environment) == "3.0\n"
    (tmp_path / "model" / "law.py").write_text(LAW.replace("2 * x", "5 * x"))
    assert answer(code, tmp_path, environment) == "7.5\n"


def test_the_time_of_a_compilation_is_told_and_that_of_the_cache_is_not(tmp_path):
    environment = small_model(tmp_path)
    code = (
        "import time; from model.compilation import compilation as c\n"
        "from model.caller import caller\n"
        "told = []; c.listener = told.append; begin = time.perf_counter()\n"
        "caller(1.5); caller(2.5)\n"
        "print(len(told), told[1:] == [c.seconds], c.seconds < time.perf_counter() - begin)\n"
    )
    assert answer(code, tmp_path, environment) == "2 True True\n"
    assert answer(code, tmp_path, environment) == "0 False True\n"


def test_processes_that_compile_at_once_leave_a_whole_cache(tmp_path):
    environment = small_model(tmp_path)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    compiling = [
        subprocess.Popen(
            [sys.executable, "-c", COMPILE, argument], env=environment, cwd=tmp_path, **pipes
        )
        for argument in ("1", "1.5", "2j")
    ]
    for process in compiling:
        assert process.stdout.readline() == "ready\n"
    for process in compiling:
        process.stdin.write("go\n")
        process.stdin.flush()
    for process in compiling:
        process.communicate(timeout=60)
        assert process.returncode == 0
    code = (
        "from model.caller import caller\n"
        "print([caller(x) for x in (1, 1.5, 2j)], sum(caller.stats.cache_hits.values()))\n"
    )
    assert answer(code, tmp_path, environment) == "[2, 3.0, 4j] 3\n"
