"""Drives one target with libFuzzer (atheris), guided by the branches of Ropeway that an input reaches."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from fuzz.guard import Guard
from fuzz.targets import MODULES

if TYPE_CHECKING:
    from fuzz.target import Target

__all__ = ["CORPUS", "corpus", "fuzz", "load"]

CORPUS: Final = Path(__file__).parent / "corpus"
"""Inputs that once were faults, in a folder for each target; made by us, or by the fuzzer and then made small."""

_INSTRUMENTED: Final = ["ropeway", "mcap", "rosbags"]
_HANG_S: Final = 30
_MEMORY_MIB: Final = 2048


def load(name: str) -> Target:
    """The target of this name."""
    found: Target = import_module(f"fuzz.targets.{MODULES[name]}").TARGETS[name]
    return found


def corpus(name: str) -> list[Path]:
    """The inputs that are kept for a target."""
    return sorted(path for path in (CORPUS / name).glob("*") if path.is_file())


def fuzz(name: str, seconds: int, faults: Path) -> None:
    """Fuzz for so long; does not return. An input that is a fault is written below ``faults`` and ends the process."""
    import atheris  # replaces the loaders of what is imported from here on

    with atheris.instrument_imports(include=_INSTRUMENTED, enable_loader_override=False):
        target = load(name)
    with TemporaryDirectory(prefix="fuzz-") as made:
        begin = Path(made) / "corpus"
        begin.mkdir()
        for number, seed in enumerate([*target.seeds(), *(path.read_bytes() for path in corpus(name))]):
            (begin / str(number)).write_bytes(seed)
        words = Path(made) / "words"
        words.write_text("# tokens\n" + "".join(f'"{_quoted(word)}"\n' for word in target.words))
        faults.mkdir(parents=True, exist_ok=True)
        options = [
            f"-max_total_time={seconds}",
            f"-max_len={target.longest_bytes}",
            f"-timeout={_HANG_S}",
            f"-rss_limit_mb={_MEMORY_MIB}",
            f"-artifact_prefix={faults}/{name}-",
            f"-dict={words}",
            "-print_final_stats=1",
            "-verbosity=1",
        ]
        atheris.Setup([sys.argv[0], *options, str(begin)], Guard(target).check)
        atheris.Fuzz()


def _quoted(word: bytes) -> str:
    return "".join(chr(b) if 32 <= b < 127 and chr(b) not in '"\\' else f"\\x{b:02X}" for b in word)
