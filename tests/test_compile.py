"""The cache of compiled kernels: never stale, and whole whoever writes it."""

import fcntl
import os
import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.forked import forks

pytestmark = pytest.mark.slow

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

PAIR = """
from typing import NamedTuple

class Pair(NamedTuple):
    a: int; b: int
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
    package = folder / "demflow" / "model"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package.parent / "__init__.py").touch()
    for name in (
        "compile.py",
        "compilation.py",
        "kernel_cache.py",
        "kernel_lending.py",
        "kernel_parts.py",
        "kernel_thrift.py",
    ):
        shutil.copy(MODEL / name, package)
    (package / "law.py").write_text(LAW)
    (package / "caller.py").write_text(CALLER)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    environment["PYTHONPATH"] = str(folder)
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # what is edited twice a second looks unchanged
    environment.pop("NUMBA_DISABLE_JIT", None)
    return environment


@pytest.fixture(scope="module")
def answer():
    """What some code prints, in a process of its own."""
    with forks() as made:
        yield made.answer


@pytest.fixture(scope="module")
def compiled(answer):
    """How many kernels are compiled anew by some code."""
    counting = "from demflow.model.compilation import compilation as c\nn=[]; c.listener=n.append\n"
    return lambda code, *where: int(answer(f"{counting}{code}\nprint(len(n))", *where))


def started(code: str, folder: Path, environment: dict[str, str]) -> str:
    """What some code prints in a Python that is started for it, as a user's is."""
    run = [sys.executable, "-c", code]
    done = subprocess.run(
        run, env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_a_changed_law_is_never_answered_from_the_cache(tmp_path, answer):
    environment = small_model(tmp_path)
    code = "from demflow.model.caller import caller; print(caller(1.5))"
    assert answer(code, tmp_path, environment) == "3.0\n"
    (tmp_path / "demflow" / "model" / "law.py").write_text(LAW.replace("2 * x", "5 * x"))
    assert answer(code, tmp_path, environment) == "7.5\n"


def test_another_numba_compiles_kernels_as_numba_does(tmp_path, answer):
    environment = small_model(tmp_path)
    policy = tmp_path / "demflow" / "model" / "compile.py"
    policy.write_text(policy.read_text().replace("PARTS_OF = (0, 68)", "PARTS_OF = (0, 0)"))
    (policy.parent / "kernel_parts.py").unlink()
    code = "from demflow.model.caller import caller; print(caller(1.5), caller(2))"
    assert answer(code, tmp_path, environment) == "3.0 4\n"


def test_the_time_of_a_compilation_is_told_and_that_of_the_cache_is_not(tmp_path):
    environment = small_model(tmp_path)
    code = (
        "import time; from demflow.model.compilation import compilation as c\n"
        "from demflow.model.caller import caller\n"
        "told = []; c.listener = told.append; begin = time.perf_counter()\n"
        "caller(1.5); caller(2.5)\n"
        "print(len(told), told[1:] == [c.seconds], c.seconds < time.perf_counter() - begin)\n"
    )
    assert started(code, tmp_path, environment) == "2 True True\n"
    assert started(code, tmp_path, environment) == "0 False True\n"


def test_the_time_in_which_kept_kernels_are_loaded_is_told_apart(tmp_path, answer):
    environment = small_model(tmp_path)
    code = (
        "import time; from demflow.model.compilation import compilation as c, loading as l\n"
        "from demflow.model.caller import caller\n"
        "begin = time.perf_counter(); caller(1.5); took = time.perf_counter() - begin\n"
        "first = l.seconds; caller(2.5)\n"
        "print(c.seconds > 0, first > 0, c.seconds + first < took, l.seconds == first)\n"
    )
    assert answer(code, tmp_path, environment) == "True True True True\n"
    assert answer(code, tmp_path, environment) == "False True True True\n"


def test_processes_that_compile_at_once_leave_a_whole_cache(tmp_path, answer):
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
        "from demflow.model.caller import caller\n"
        "print([caller(x) for x in (1, 1.5, 2j)], sum(caller.stats.cache_hits.values()))\n"
    )
    assert answer(code, tmp_path, environment) == "[2, 3.0, 4j] 3\n"


def test_a_process_that_was_stopped_in_its_turn_holds_nobody_for_ever(tmp_path, answer):
    environment = small_model(tmp_path)
    code = (
        "from demflow.model import kernel_cache\n"
        "kernel_cache.INDEX_PATIENCE = kernel_cache.COMPILING_PATIENCE = 0.05\n"
        "from demflow.model.caller import caller; print(caller(1.5))\n"
    )
    assert answer(code, tmp_path, environment) == "3.0\n"
    (cache,) = (tmp_path / "cache" / "demflow").iterdir()
    locks = [path for path in cache.iterdir() if path.name.endswith(".lock")]
    assert len(locks) > 1  # of the index, and of a kernel
    kept = {path.name for path in cache.iterdir()}
    for path in cache.glob("*.nb*"):
        path.unlink()
    with ExitStack() as stack:
        for path in locks:
            fcntl.flock(stack.enter_context(path.open("w")), fcntl.LOCK_EX)
        assert answer(code, tmp_path, environment) == "3.0\n"
        assert {path.name for path in cache.iterdir()} == {path.name for path in locks}
    assert answer(code, tmp_path, environment) == "3.0\n"
    assert {path.name for path in cache.iterdir()} == kept


def test_an_edit_that_means_nothing_compiles_nothing(tmp_path, compiled):
    environment = small_model(tmp_path)
    law = tmp_path / "demflow" / "model" / "law.py"
    code = "from demflow.model.caller import caller; caller(1.5)"
    assert compiled(code, tmp_path, environment) > 0
    for text in (
        LAW,
        f"# a comment above\n\n{LAW}",
        LAW.replace("return", "# another\n    return"),
        LAW.replace("    return", '    """A law."""\n    return'),
        LAW + "\nunused = 3\n",
    ):
        law.write_text(text)
        assert compiled(code, tmp_path, environment) == 0, text


def test_what_a_kernel_names_is_part_of_what_it_means(tmp_path, answer):
    environment = small_model(tmp_path)
    law = tmp_path / "demflow" / "model" / "law.py"
    code = "from demflow.model.caller import caller; print(caller(1.5))"
    two = LAW.replace("2 * x", "FACTOR * x")
    for factor, right in (("2", "3.0\n"), ("7", "10.5\n"), ("2", "3.0\n")):
        law.write_text(two + f"\nFACTOR = {factor}\n")
        assert answer(code, tmp_path, environment) == right


def test_the_order_of_the_fields_that_are_passed_counts(tmp_path, answer):
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "law.py").write_text(LAW.replace("2 * x", "x.a + 10 * x.b"))
    (tmp_path / "pair.py").write_text(PAIR)
    code = (
        "from pair import Pair; from demflow.model.caller import caller; print(caller(Pair(1, 2)))"
    )
    assert answer(code, tmp_path, environment) == "21\n"
    (tmp_path / "pair.py").write_text(PAIR.replace("a: int; b: int", "b: int; a: int"))
    assert answer(code, tmp_path, environment) == "12\n"
    (tmp_path / "pair.py").write_text(PAIR.replace("Pair", "Couple"))  # its type is gone
    assert answer(code.replace("Pair", "Couple"), tmp_path, environment) == "21\n"


@pytest.mark.parametrize("gone", ["the module", "the name"])
def test_types_that_another_version_passed_are_in_nobody_s_way(tmp_path, gone, compiled, answer):
    """A kernel may have been compiled for types that this version has not got."""
    environment = small_model(tmp_path)
    pair = tmp_path / "pair.py"
    pair.write_text(PAIR)
    law = LAW.replace("2 * x", "2 * x[0]")
    (tmp_path / "demflow" / "model" / "law.py").write_text(law)
    code = "from demflow.model.caller import caller; print(caller((1.5,)))"
    other = "from pair import Pair; from demflow.model.caller import caller; caller(Pair(1, 2))"
    assert compiled(other, tmp_path, environment) > 0
    if gone == "the module":
        pair.unlink()
    else:
        pair.write_text(PAIR.replace("Pair", "Couple"))
    assert answer(code, tmp_path, environment) == "3.0\n"
    assert answer(code, tmp_path, environment) == "3.0\n"


def test_a_folder_that_others_can_write_holds_no_kernels(tmp_path, answer):
    environment = small_model(tmp_path)
    planted = tmp_path / "cache" / "demflow"
    planted.mkdir(parents=True)
    code = "from demflow.model.kernel_cache import cache_folder; print(cache_folder())"
    name = Path(answer(code, tmp_path, environment).strip()).name
    assert (planted / name).stat().st_mode & 0o777 == 0o700
    (planted / name).chmod(0o777)
    assert Path(answer(code, tmp_path, environment).strip()).parent != planted


REFUSING = """
from demflow.model.compile import kernel

@kernel
def law(x):
    if x < 0:
        raise ValueError("below zero", 7)
    return 2 * x
"""

TWICE = """
from demflow.model.compile import kernel
from demflow.model.law import law

@kernel
def caller(x):
    return law(1) + law(2) * law(x)
"""


def test_what_a_kernel_inside_another_raises_is_told_whole(tmp_path, answer):
    """Its constants are set where it lies, compiled just now or kept."""
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "law.py").write_text(REFUSING)
    code = (
        "from demflow.model.caller import caller\n"
        "print(caller(1.5))\n"
        "try: caller(-1.0)\n"
        "except ValueError as error: print(error.args)\n"
    )
    for _ in range(2):
        assert answer(code, tmp_path, environment) == "3.0\n('below zero', 7)\n"


FILLING = """
import numpy as np
from demflow.model.compile import kernel

@kernel
def law(x):
    y = np.empty(3)
    y[:] = x
    return 2 * y.sum()
"""


def test_what_numba_raises_inside_a_kernel_is_told_with_its_numbers(tmp_path, answer):
    """It gathers them in a function of its own, which cannot be taken in."""
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "law.py").write_text(FILLING)
    code = (
        "import numpy as np; from demflow.model.caller import caller\n"
        "print(caller(np.ones(3)))\n"
        "try: caller(np.ones(2))\n"
        "except ValueError as error: print('2' in str(error))\n"
    )
    for _ in range(2):
        assert answer(code, tmp_path, environment) == "6.0\nTrue\n"


def test_numbers_written_in_a_call_compile_nothing_of_their_own(tmp_path, answer):
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "caller.py").write_text(TWICE)
    code = (
        "from numba.core import event\n"
        "class Heard(event.Listener):\n"
        "    names = []\n"
        "    def on_start(self, e): self.names.append(e.data['dispatcher'].py_func.__name__)\n"
        "    def on_end(self, e): pass\n"
        "event.register('numba:compile', Heard())\n"
        "from demflow.model.caller import caller\n"
        "from demflow.model.law import law\n"
        "print(caller(3), law(3), sorted(Heard.names))\n"
    )
    # once inside the caller, once for Python
    assert answer(code, tmp_path, environment) == "26 6 ['caller', 'law', 'law']\n"


MANY = """
from typing import NamedTuple
import numpy as np
from demflow.model.compile import kernel

Many = NamedTuple("Many", [(f"field{k}", np.ndarray) for k in range(20)])

@kernel
def law(many, k):
    total = 0.0
    for j in range(3):
        total += many.field0[k] * many.field1[k] / (1.0 + many.field2[k]) + many.field3[k]
        total -= min(many.field4[k], many.field5[k]) * np.sqrt(many.field6[k] + total * total)
        if total > many.field7[k]:
            return total
        many.field8[k] = total
    return total
"""

SUMS = """
from demflow.model.compile import kernel
from demflow.model.law import law

@kernel
def caller(many):
    total = 0.0
    for k in range(many.field0.size):
        if many.field9[k] > 0.0:
            total += law(many, k)
        else:
            total -= law(many, k)
    return total
"""


def machine_code(tmp_path, answer, said):
    """What code says of `lines`, those of a kernel that calls another in a loop, as compiled."""
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "law.py").write_text(MANY)
    (tmp_path / "demflow" / "model" / "caller.py").write_text(SUMS)
    code = (
        "import numpy as np\n"
        "from demflow.model.caller import caller\n"
        "from demflow.model.law import Many\n"
        "caller(Many(*np.ones((20, 5))))\n"
        "lines = next(iter(caller.inspect_llvm().values())).splitlines()\n"
    )
    return answer(code + said, tmp_path, environment)


def test_a_kernel_takes_in_what_it_calls(tmp_path, answer):
    """No call is left that would hand on all arrays of a tuple."""
    said = "print(sum(' call ' in line and 'law' in line for line in lines))\n"
    assert machine_code(tmp_path, answer, said) == "0\n"


def test_a_kernel_counts_nothing_that_it_is_given(tmp_path, answer):
    """Nor do kernels inside it: only the wrapper does, through which Python calls it."""
    said = (
        "kernel = '\\n'.join(lines).split('define ')[1]\n"
        "print('caller' in kernel, 'NRT' in kernel)\n"
    )
    assert machine_code(tmp_path, answer, said) == "True False\n"


KEPT = """
from typing import NamedTuple
import numpy as np
from demflow.model.compile import kernel

class Pair(NamedTuple):
    one: np.ndarray
    two: np.ndarray

@kernel
def law(pair, first):
    if first:
        chosen = pair.one
    else:
        chosen = pair[-1]
    return chosen
"""

KEEPING = """
from demflow.model.compile import kernel
from demflow.model.law import Pair, law

@kernel
def caller(pair, times):
    one = pair.one
    other = law(pair, False)
    for k in range(times):
        pair = Pair(other + k, one)
        other = law(pair, k % 2 == 0)
    return one, law(pair, True), law(pair, False), other, pair
"""


@pytest.mark.parametrize("times", [0, 1, 2, 3])
def test_what_is_lent_lives_as_long_as_somebody_has_it(tmp_path, times, answer):
    """Returned, kept in a tuple or let go: values and counts are those of plain Python."""
    environment = small_model(tmp_path)
    (tmp_path / "demflow" / "model" / "law.py").write_text(KEPT)
    (tmp_path / "demflow" / "model" / "caller.py").write_text(KEEPING)
    code = (
        "import gc, sys, numpy as np\n"
        "from demflow.model.caller import caller\n"
        "from demflow.model.law import Pair\n"
        "flat = lambda got: [x.tolist() for x in (*got[:-1], *got[-1])]\n"
        "def run(function, calls):\n"
        "    arrays = [np.arange(1000.0), np.arange(1000.0) + 0.5]\n"
        "    before = [sys.getrefcount(a) for a in arrays]\n"
        f"    got = [function(Pair(*arrays), {times}) for _ in range(calls)]\n"
        "    assert [sys.getrefcount(a) >= b for a, b in zip(arrays, before)] == [True, True]\n"
        "    kept, got = got[-1], None\n"
        "    held = [sys.getrefcount(a) - b for a, b in zip(arrays, before)]\n"
        "    del arrays; [np.full(1000, -1.0) for _ in range(100)]\n"
        "    return flat(kept), held\n"
        "values, held = run(caller, 1)\n"
        "again, many = run(caller, 50)\n"
        "plain, _ = run(caller.py_func, 1)\n"
        "print(values == again == plain, held == many, min(held) >= 0)\n"
    )
    assert answer(code, tmp_path, environment) == "True True True\n"
