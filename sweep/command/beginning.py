"""What helps to begin: a study to change, and completion of commands in a shell."""

from __future__ import annotations

import argparse
import json
import re
import shutil
from pathlib import Path

from demflow.sweep.command.terminal import say, show
from demflow.sweep.errors import ResultsError

EXAMPLES = Path(__file__).parents[2] / "studies"
SHELLS = ("bash", "zsh", "fish")
SCHEMA_FILE = "demflow.schema.json"  # beside a new study


def examples() -> dict[str, Path]:
    """The studies that come with the program, by name; the first to read first."""
    found = {path.stem: path for path in sorted(EXAMPLES.glob("*.yaml"))}
    first = {name: found.pop(name) for name in ("quickstart",) if name in found}
    return {**first, **found}


def title_of(path: Path) -> str:
    """What a study is about, from its text."""
    match = re.search(r"^title: *(.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return match[1].strip("'\" ") if match else ""


def write_schema(file: Path) -> str:
    """Write the JSON Schema of a study to a file.

    Returns the first line with which a study in the same folder names it to editors
    (yaml-language-server, as VS Code, Vim and Emacs use it). Raises ResultsError where the file is
    another one than an older schema, or its name has blanks, at which editors stop reading.
    """
    from demflow.sweep.study.schema import study_schema

    content = study_schema()
    if re.search(r"\s", file.name):
        raise ResultsError(f"'{file.name}' has blanks, at which editors stop; try {SCHEMA_FILE}")
    if file.exists() and not _is_schema(file, content["title"]):
        raise ResultsError(f"{file} is there already and no schema of studies; give another name")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return f"# yaml-language-server: $schema={file.name}"


def _is_schema(file: Path, title: str) -> bool:
    try:
        found = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("title") == title


def _meant(name: str, known: dict[str, Path]) -> str:
    """The study with a word in its name, or else its title, where there is but one; else the name.

    Raises ResultsError where there are several.
    """
    if name in known:
        return name
    word = name.casefold()
    for said in (
        [key for key in known if word in key.split("_")],
        [key for key in known if word in re.findall(r"\w+", title_of(known[key]).casefold())],
    ):
        if len(said) > 1:
            raise ResultsError(f"several studies are about '{name}': {', '.join(said)}; name one")
        if said:
            return said[0]
    return name


def begin(name: str, file: Path | None) -> list[Path]:
    """Copy a study that comes with the program, and the files that it names.

    The schema of studies is written beside it, and its first line names that to editors.

    Returns what was written. Raises ResultsError where there is no such study, or a file is there
    already.
    """
    from demflow.sweep.study.load import load_study
    from demflow.sweep.study.units import nearest

    known = examples()
    name = _meant(name, known)
    if name not in known:
        like = nearest(name, known)
        hint = f"did you mean '{like}'?" if like else f"there are {', '.join(known)}"
        raise ResultsError(f"no study is named '{name}'; {hint}")
    target = file or Path(f"{name}.yaml")
    named = [one.path for one in load_study(known[name]).files.values()]
    copies = {target: known[name]}
    copies |= {target.parent / p.relative_to(known[name].parent): p for p in named}
    there = [path for path in copies if path.exists()]
    if there:
        raise ResultsError(f"{there[0]} is there already; nothing was written. Give another name")
    schema = target.parent / SCHEMA_FILE
    line = write_schema(schema)  # refuses before anything is copied
    for path, source in copies.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, path)
    target.write_text(f"{line}\n{target.read_text(encoding='utf-8')}", encoding="utf-8")
    return [*copies, schema]


def new(options: argparse.Namespace) -> int:
    """Copy a study that comes with the program, to be changed; without a name, list them."""
    if options.name is None:
        for name, path in examples().items():
            show(f"{name:26} {title_of(path)}")
        return 0
    written = begin(options.name, options.file)
    for path in written:
        show(str(path))
    say(f"change it, then: demflow check {written[0]}; demflow run {written[0]}")
    return 0


def completion(options: argparse.Namespace) -> int:
    """Print the completion of commands for a shell, as in: source <(demflow completion bash)."""
    show(script(options.shell, options.described))
    return 0


def script(shell: str, described: dict[str, tuple[str, list[str]]]) -> str:
    """The completion of a shell.

    Parameters
    ----------
    shell : one of `SHELLS`.
    described : of each command its first line and its options.
    """
    if shell == "fish":
        return "\n".join(_fish(described))
    commands = " ".join(described)
    cases = "\n".join(
        f'        {name}) words="{" ".join(options)}" ;;'
        for name, (_, options) in described.items()
    )
    names = " ".join(examples())
    begin = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return f"""{begin}_demflow() {{
    local current="${{COMP_WORDS[COMP_CWORD]}}" words
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{commands}" -- "$current"))
        return
    fi
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    if [ "${{COMP_WORDS[1]}}" = new ] && [ "$COMP_CWORD" -eq 2 ]; then
        words="{names}"
    fi
    case "$current" in
        -*) COMPREPLY=($(compgen -W "$words" -- "$current")) ;;
        *) if [ "${{COMP_WORDS[1]}}" = new ]; then
               COMPREPLY=($(compgen -W "$words" -- "$current"))
           else
               COMPREPLY=($(compgen -f -- "$current"))
           fi ;;
    esac
}}
complete -o filenames -F _demflow demflow"""


def _fish(described: dict[str, tuple[str, list[str]]]) -> list[str]:
    lines = []
    for name, (told, options) in described.items():
        quoted = told.replace("\\", "\\\\").replace("'", "\\'")
        lines.append(f"complete -c demflow -n __fish_use_subcommand -f -a {name} -d '{quoted}'")
        within = f"'__fish_seen_subcommand_from {name}'"
        lines += [
            f"complete -c demflow -n {within} -l {option.removeprefix('--')}"
            for option in options
            if option.startswith("--")
        ]
    names = " ".join(examples())
    lines.append(f"complete -c demflow -n '__fish_seen_subcommand_from new' -f -a '{names}'")
    return lines
