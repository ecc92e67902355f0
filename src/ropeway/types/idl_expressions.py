"""Walks over the tokens of an ``.idl`` file: names, annotations and constant expressions."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Final, TypeAlias

from ropeway.types.definition import FieldType
from ropeway.types.idl_tokens import IdlError, Token

__all__ = ["Expressions", "Value"]

Value: TypeAlias = bool | int | float | str

_OPERATORS: Final[tuple[tuple[str, ...], ...]] = (("|",), ("^",), ("&",), ("<<", ">>"), ("+", "-"), ("*", "/", "%"))
"""By precedence, the weakest first."""

_DEEPEST: Final = 64
_LARGEST: Final = 1 << 64
_LONGEST_SHIFT: Final = 63
_EVALUATED: Final = ("default", "value", "position", "bit_bound")


class Expressions:
    """A position in the tokens, and the names that are known there."""

    def __init__(self, found: list[Token]) -> None:
        self.tokens = found
        self.position = 0
        self.scope: tuple[str, ...] = ()
        self.known: dict[tuple[str, ...], FieldType | Value] = {}
        self._depth = 0

    @property
    def token(self) -> Token:
        """The token that comes next."""
        return self.tokens[self.position]

    def fault(self, reason: str, *, back: int = 0) -> IdlError:
        """Make the error for the next token, or for the one ``back`` tokens before it."""
        return IdlError(self.tokens[max(self.position - back, 0)].line, reason)

    def take(self, text: str) -> bool:
        """Pass over the next token if it is the sign or word ``text``."""
        if self.token.text != text or self.token.kind not in ("sign", "name"):
            return False
        self.position += 1
        return True

    def expect(self, text: str) -> None:
        """Pass over the sign ``text``, which must come."""
        if not self.take(text):
            raise self.fault(f"expected {text!r}, found {self.token.text or 'the end'!r:.40}")

    def word(self, wanted: str) -> str:
        """Pass over a name and return it."""
        if self.token.kind != "name":
            raise self.fault(f"expected {wanted}, found {self.token.text or 'the end'!r:.40}")
        self.position += 1
        return self.tokens[self.position - 1].text

    def scoped_name(self) -> tuple[str, ...]:
        """Read ``a::b::c``; the first part is ``""`` where it begins with ``::``."""
        parts = [""] if self.take("::") else []
        parts.append(self.word("a name"))
        while self.take("::"):
            parts.append(self.word("a name"))
        return tuple(parts)

    def look_up(self, path: tuple[str, ...]) -> FieldType | Value | None:
        """Resolve a name: the innermost module that defines it wins."""
        if path[0] == "":
            return self.known.get(path[1:])
        for depth in range(len(self.scope), -1, -1):
            found = self.known.get((*self.scope[:depth], *path))
            if found is not None:
                return found
        return None

    def annotations(self) -> dict[str, Value]:
        """Read annotations, and return the values of those that mean something to a message."""
        found: dict[str, Value] = {}
        while self.take("@"):
            name = self.scoped_name()[-1]
            if not self.take("("):
                continue
            if name not in _EVALUATED:
                self._skip()
                continue
            if self.token.text == "value" and self.tokens[self.position + 1].text == "=":
                self.position += 2
            found[name] = self.expression(")")
            self.expect(")")
        return found

    def expression(self, closing: str = "") -> Value:
        """Read a constant expression; ``closing`` is the sign that ends it and so is no operator."""
        return self._binary(0, closing)

    def _binary(self, level: int, closing: str) -> Value:
        if level == len(_OPERATORS):
            return self._unary(closing)
        left = self._binary(level + 1, closing)
        while sign := self._operator(level, closing):
            right = self._binary(level + 1, closing)
            left = self._computed(sign, left, right)
        return left

    def _operator(self, level: int, closing: str) -> str:
        for sign in _OPERATORS[level]:
            if sign == ">>":
                double = self.token.text == ">" and self.tokens[self.position + 1].text == ">"
                if double and closing != ">":
                    self.position += 2
                    return sign
            elif self.token.kind == "sign" and self.take(sign):
                return sign
        return ""

    def _unary(self, closing: str) -> Value:
        for sign, compute in _UNARY.items():
            if self.token.kind == "sign" and self.take(sign):
                value = self._deeper(lambda: self._unary(closing))
                if isinstance(value, str) or (sign == "~" and isinstance(value, float)):
                    raise self.fault(f"{sign} needs a number", back=1)
                made: Value = compute(value)
                return made
        if self.take("("):
            inner = self._deeper(lambda: self.expression())
            self.expect(")")
            return inner
        return self._literal()

    def _deeper(self, read: Callable[[], Value]) -> Value:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self.fault("the expression is nested too deeply")
        value = read()
        self._depth -= 1
        return value

    def _literal(self) -> Value:
        token = self.token
        if token.kind == "string":
            text = ""
            while self.token.kind == "string":
                text += self.token.text
                self.position += 1
            return text
        if token.kind == "number":
            self.position += 1
            return self._number(token.text)
        if token.kind == "character":
            self.position += 1
            return ord(token.text[0])
        if token.text in ("TRUE", "FALSE"):
            self.position += 1
            return token.text == "TRUE"
        if token.kind == "name" or token.text == "::":
            path = self.scoped_name()
            found = self.look_up(path)
            if found is None or isinstance(found, FieldType):
                raise self.fault(f"{'::'.join(path)} is not a known constant", back=1)
            return found
        raise self.fault(f"expected a value, found {token.text or 'the end'!r:.40}")

    def _number(self, text: str) -> int | float:
        try:
            if text[:2] in ("0x", "0X"):
                return self._bounded(int(text, 16))
            plain = text.rstrip("dDfFlLuU")
            if (plain != text and text[-1] in "dDfF") or set(plain) & set(".eE"):
                return float(plain)
            return self._bounded(int(plain, 8) if len(plain) > 1 and plain[0] == "0" else int(plain))
        except ValueError:
            raise self.fault(f"{text:.40} is not a number", back=1) from None

    def _bounded(self, value: int) -> int:
        if abs(value) > _LARGEST:
            raise self.fault("a number is beyond 64 bits", back=1)
        return value

    def _computed(self, sign: str, left: Value, right: Value) -> Value:
        whole = isinstance(left, int) and isinstance(right, int)
        if isinstance(left, str) or isinstance(right, str) or (not whole and sign in ("|", "^", "&", "<<", ">>", "%")):
            raise self.fault(f"{sign} needs numbers", back=1)
        if sign in ("<<", ">>") and not 0 <= right <= _LONGEST_SHIFT:
            raise self.fault(f"{right} is not a number of bits to shift by", back=1)
        try:
            made: int | float = _BINARY["//" if sign == "/" and whole else sign](left, right)
        except (ZeroDivisionError, OverflowError):
            raise self.fault("the expression has no value", back=1) from None
        return self._bounded(made) if isinstance(made, int) else made

    def _skip(self) -> None:
        """Pass over the rest of a pair of parentheses."""
        depth = 1
        while depth:
            if self.token.kind == "end":
                raise self.fault("expected ')', found the end")
            if self.token.kind == "sign":
                depth += {"(": 1, ")": -1}.get(self.token.text, 0)
            self.position += 1


_UNARY: Final[dict[str, Callable[[Any], Any]]] = {"-": operator.neg, "+": operator.pos, "~": operator.invert}
_BINARY: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "|": operator.or_,
    "^": operator.xor,
    "&": operator.and_,
    "<<": operator.lshift,
    ">>": operator.rshift,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "//": operator.floordiv,
    "%": operator.mod,
}
