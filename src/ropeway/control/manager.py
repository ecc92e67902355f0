"""Manages a running gateway: what it shows, what may be asked of it, and every change of its configuration.

All changes take this way, whoever wants them (the control API, SIGHUP, a file that is watched): planned, written into
the journal, applied, confirmed. One at a time.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ropeway.audit.note import NO_AUDIT, Auditor
from ropeway.control.auditing import reload_audited
from ropeway.control.edits import Edit
from ropeway.control.events import Events
from ropeway.control.record import ChangeRecord, file_digest
from ropeway.errors import ConfigError, ControlRefused, RopewayError
from ropeway.gateway.auth import make_door
from ropeway.gateway.config.config import Config, parse
from ropeway.gateway.plan import ConfigPlan, make_plan
from ropeway.loading import load

if TYPE_CHECKING:
    from ropeway.audit.trail import AuditTrail
    from ropeway.control.caller import Caller
    from ropeway.control.metrics import Metrics
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.questions import Question
    from ropeway.gateway.process.supervisor import Supervisor
    from ropeway.listener.authentication import Door

__all__ = ["Applied", "Manager"]

log = logging.getLogger("ropeway.control")

_WATCH_S: Final = 1.0  # an editor writes a file in several steps


@dataclass(frozen=True, slots=True)
class Applied:
    """A change that was confirmed. ``number`` is its entry in the journal, 0 where there is none."""

    plan: ConfigPlan
    number: int

    def to_json(self) -> dict[str, Any]:
        """Return what was done as JSON."""
        return {**self.plan.to_json(), "applied": self.plan.old.etag != self.plan.new.etag, "number": self.number}


class Manager:
    """Stands between the control API and what runs: a gateway in this process, or the supervisor of workers."""

    def __init__(
        self, running: Gateway | Supervisor, record: ChangeRecord | None = None, trail: AuditTrail | None = None
    ) -> None:
        self.running = running
        self.trail = trail
        self.audit: Auditor = NO_AUDIT if trail is None else trail
        self.events = Events()
        self.record = record or ChangeRecord(None)
        self._metrics: Metrics | None = None
        self._on_door: list[Callable[[Door], None]] = []
        self._changing = asyncio.Lock()
        self._planning = asyncio.Lock()

    @property
    def config(self) -> Config:
        """The configuration that runs."""
        return self.running.config

    def status(self) -> dict[str, Any]:
        """Return the state of everything as JSON."""
        return self.running.status()

    async def metrics(self) -> Metrics:
        """Return what writes the metrics; it is loaded when somebody asks for them."""
        module = await load("ropeway.control.metrics")
        if self._metrics is None:
            self._metrics = module.Metrics(self.status)
        return self._metrics

    async def ask(self, question: Question, params: Mapping[str, Any]) -> list[Any]:
        """Return the answers of the gateway, or of all its workers, to a question (``gateway/process/questions.py``).

        Raises what one of them raises.
        """
        return await self.running.ask(question, params)

    async def ask_one(self, question: Question, params: Mapping[str, Any]) -> Any:
        """Return one answer to a question about the networks, which the gateway and all its workers know alike."""
        return await self.running.ask_one(question, params)

    def on_door(self, renew: Callable[[Door], None]) -> None:
        """Call ``renew`` with the rules for who may come in, whenever they have changed."""
        self._on_door.append(renew)

    def reload(self) -> None:
        """Read certificates and tokens again, for the listeners and for the control API. Raises ``ConfigError``."""
        door = make_door(self.config.gateway)
        self.running.reload()
        for renew in self._on_door:
            renew(door)

    # ── changes ────────────────────────────────────────────────────────────────────────────────────────────────

    async def read(self, document: Any, directory: str | Path = ".", source: str = "") -> Config:
        """Read a configuration that somebody wants. Raises ``ConfigError`` with every fault."""
        async with self._planning:
            try:
                return await asyncio.to_thread(_read, document, source or self.config.source, directory)
            except ConfigError as error:
                # what somebody sent does not stand in the file that the gateway was started with
                raise ConfigError(error.problems, source) from None

    async def plan(self, config: Config) -> ConfigPlan:
        """Return what a configuration would change; nothing is done."""
        async with self._planning:
            return await asyncio.to_thread(make_plan, self.config, config)

    async def apply(
        self, config: Config, caller: Caller, *, action: str = "apply", note: str = "", if_match: str | None = None
    ) -> Applied:
        """Go over to another configuration; once this returns, it survives whatever happens.

        ``if_match`` is the ``etag`` of the configuration that the caller knows. Raises ``ControlRefused`` with what was
        changed meanwhile where that is not the one that runs, and ``RopewayError`` where it cannot be applied; then
        everything is as before.
        """
        async with self._changing:
            return await self._apply(config, caller, action, note, if_match)

    async def edit(
        self,
        change: Edit,
        caller: Caller,
        *,
        action: str,
        if_match: str | None = None,
    ) -> Applied:
        """Apply what ``change`` makes of the configuration that runs, in the full form."""
        async with self._changing:
            document = self.config.to_json()
            change(self.config, document)
            config = await self.read(document)
            return await self._apply(config, caller, action, "", if_match)

    async def apply_file(self, caller: Caller) -> str:
        """Apply the file again if it has changed; read certificates and tokens again. Return what was done.

        Raises ``RopewayError``; nothing has changed then.
        """
        with reload_audited(self.audit, caller):
            return await self._apply_file(caller)

    async def _apply_file(self, caller: Caller) -> str:
        file = self.record.file
        changed = file is not None and await asyncio.to_thread(self.record.file_changed)
        self.reload()
        if not changed or file is None:
            return "certificates and tokens were read again"
        from ropeway.gateway.config.fleet import load_one

        async with self._changing:
            config = await asyncio.to_thread(load_one, file, self.record.part)
            applied = await self._apply(config, caller, "reload", "", None)
            await asyncio.to_thread(self.record.file_changed, seen=True)
        steps = len(applied.plan.steps)
        return f"{file} was applied: {steps} step{'' if steps == 1 else 's'}" if steps else f"{file} changes nothing"

    async def watch_file(self, caller: Caller) -> None:
        """Apply the file whenever it has changed, for ever; a file that cannot be applied is told once."""
        told = ""
        while True:
            await asyncio.sleep(_WATCH_S)
            digest = await asyncio.to_thread(file_digest, self.record.file)
            if digest in ("", told) or not await asyncio.to_thread(self.record.file_changed):
                continue
            told = digest
            try:
                log.info("%s", await self.apply_file(caller))
            except RopewayError as error:
                log.error("nothing has changed: %s", error)

    async def rollback(self, caller: Caller, number: int | None = None, *, if_match: str | None = None) -> Applied:
        """Go back to the configuration of an entry of the journal, or to the one before the last change."""
        async with self._changing:
            entry = await self.record.entry_to_go_back_to(number, self.config.etag)
            config = await self.read(await self.record.config(entry))
            return await self._apply(config, caller, "rollback", f"to {entry.number}", if_match)

    async def _apply(self, config: Config, caller: Caller, action: str, note: str, if_match: str | None) -> Applied:
        await self._check_known(if_match)
        before = self.config
        plan = await self.plan(config)
        if config.etag == before.etag:
            return Applied(plan, 0)
        entry = await self.record.begin(config, plan, caller, action, note)
        try:
            await self.running.apply(config, plan)
        except BaseException as error:
            await self.record.fail(entry, str(error) or type(error).__name__)
            self.events.tell("config", config.gateway.name, action=action, who=caller.name, failed=str(error))
            raise
        try:
            await self.record.confirm(entry)
        except RopewayError:
            log.error("the change cannot be written down; it is taken back")
            await self.running.apply(before)
            raise
        self._renewed()
        log.info("%s by %s (%s): %s", action, caller.name, caller.where, _summary(plan))
        number = 0 if entry is None else entry.number
        steps = [step.to_json() for step in plan.steps]
        self.events.tell(
            "config", config.gateway.name, action=action, who=caller.name, number=number, etag=config.etag, steps=steps
        )
        return Applied(plan, number)

    async def _check_known(self, if_match: str | None) -> None:
        """Refuse a change of who has not seen the configuration that runs."""
        wanted = "" if if_match is None else if_match.strip().strip('"')
        if wanted in ("", "*", self.config.etag):
            return
        known = await self.record.config_of(wanted)
        meanwhile = [] if known is None else (await self.plan_from(known)).to_json()["steps"]
        text = "somebody else has changed the configuration meanwhile; look at it, and try again"
        raise ControlRefused(
            409, text, {"etag": self.config.etag, "meanwhile": meanwhile}, headers={"etag": f'"{self.config.etag}"'}
        )

    async def plan_from(self, document: Any) -> ConfigPlan:
        """Return what lies between another configuration and the one that runs."""
        old = await self.read(document)
        return await asyncio.to_thread(make_plan, old, self.config)

    def _renewed(self) -> None:
        if self._on_door:
            try:
                door = make_door(self.config.gateway)
            except ConfigError as error:
                log.error("the control API goes on with the tokens that it has: %s", error)
                return
            for renew in self._on_door:
                renew(door)

    async def close(self) -> None:
        """End what the manager began."""
        self.events.close()
        await self.record.close()


def _read(document: Any, source: str, directory: str | Path) -> Config:
    config = parse(document, source, directory=directory)
    _ = config.etag  # here, where it holds nobody up
    return config


def _summary(plan: ConfigPlan) -> str:
    counts: dict[str, int] = {}
    for step in plan.steps:
        counts[step.action] = counts.get(step.action, 0) + 1
    return ", ".join(f"{count} to {action}" for action, count in counts.items())
