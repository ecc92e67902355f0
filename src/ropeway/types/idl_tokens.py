"""Splits the text of an ``.idl`` file into tokens, each with the number of its line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

__all__ = ["IdlError", "Token", "tokens"]

_TOKEN: Final = re.compile(
    r"""(?P<space>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<directive>\#[^\n]*)
      | (?P<string>L?"(?:\\.|[^"\\])*")
      | (?P<character>L?'(?:\\[^\n]{1,5}?|[^'\\\n])')
      | (?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?[dDfFlLuU]?)
      | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<sign>::|<<|[{}()\[\]<>;:,=@+\-*/%&|^~?])""",
    re.VERBOSE | re.DOTALL,
)
_HARMLESS: Final = re.compile(r"#\s*(include\b|pragma\b|ifndef\b|define\s+\w+\s*$|endif\b|$)")
_ESCAPE: Final = re.compile(r"\\(?:x([0-9a-fA-F]{1,2})|u([0-9a-fA-F]{1,4})|([0-7]{1,3})|(.))", re.DOTALL)
_LETTERS: Final = {"n": "\n", "t": "\t", "v": "\v", "b": "\b", "r": "\r", "f": "\f", "a": "\a"}


class IdlError(ValueError):
    """A fault in the text, at a line."""

    def __init__(self, line: int, reason: str) -> None:
        self.line, self.reason = line, reason
        super().__init__(f"line {line}: {reason}")


class Token(NamedTuple):
    """A word, literal or sign. ``kind`` is a group of the pattern, ``end`` at the end of the text."""

    kind: str
    text: str
    line: int


def tokens(text: str) -> Iterator[Token]:
    """Yield the tokens of ``text``; the last one has the kind ``end``.

    Comments, includes, pragmas and the guard around a file are left out: what a type needs is found by its name.
    Raises ``IdlError``.
    """
    line, position = 1, 0
    while position < len(text):
        found = _TOKEN.match(text, position)
        if found is None:
            raise IdlError(line, f"{text[position : position + 20].splitlines()[0]!r} is not IDL")
        kind, piece = str(found.lastgroup), found[0]
        if kind == "directive":
            if not _HARMLESS.match(piece):
                raise IdlError(line, f"{piece.strip()!r}: only #include, #pragma and a guard are understood")
        elif kind in ("string", "character"):
            yield Token(kind, _unescaped(piece.removeprefix("L")[1:-1]), line)
        elif kind != "space":
            yield Token(kind, piece, line)
        line += piece.count("\n")
        position = found.end()
    yield Token("end", "", line)


def _unescaped(text: str) -> str:
    def replaced(found: re.Match[str]) -> str:
        if found[1] or found[2]:
            point = int(found[1] or found[2], 16)
            return "\ufffd" if 0xD800 <= point < 0xE000 else chr(point)  # half a surrogate pair is not text
        return chr(int(found[3], 8)) if found[3] else _LETTERS.get(found[4], found[4])

    return _ESCAPE.sub(replaced, text)
