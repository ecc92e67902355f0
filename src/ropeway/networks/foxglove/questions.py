"""Answers what takes a while for one viewer: requests for parameters, in order, and for files."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ropeway.errors import InvalidOperation
from ropeway.limits import VIEWER_PARAMETERS_WATCHED, VIEWER_QUESTIONS
from ropeway.networks.foxglove import wire
from ropeway.networks.foxglove.assets import AssetRefused
from ropeway.networks.foxglove.values import shown_parameter
from ropeway.tasks import Chores

if TYPE_CHECKING:
    from ropeway.networks.foxglove.host import Place, ViewerHost

__all__ = ["ViewerQuestions"]


class ViewerQuestions:
    """The questions of a viewer that are under way, and the parameters whose changes it is told."""

    def __init__(self, viewer: ViewerHost, place: Place) -> None:
        self._viewer, self._place = viewer, place
        self._chores = Chores()
        self._turn = asyncio.Lock()
        self.watched: set[str] = set()
        """The parameters whose changes the viewer is told."""
        self._changed: dict[str, dict[str, Any]] = {}

    def ask(self, op: wire.GetParameters | wire.SetParameters | wire.FetchAsset) -> None:
        """Answer a question. Raises ``InvalidOperation`` where too many are under way."""
        if len(self._chores.tasks) >= VIEWER_QUESTIONS:
            if isinstance(op, wire.FetchAsset):
                self._viewer.sender.binary(wire.asset_error(op.request_id, "too many requests are under way"))
                return
            raise InvalidOperation(op.op, f"{VIEWER_QUESTIONS} requests of this viewer are not answered yet")
        match op:
            case wire.FetchAsset():
                self._chores.start(self._fetch(op), "file for a viewer")
            case wire.GetParameters():
                self._chores.start(self._get(op), "parameters for a viewer")
            case wire.SetParameters():
                self._chores.start(self._set(op), "parameters of a viewer")

    async def _get(self, op: wire.GetParameters) -> None:
        async with self._turn:
            await self._viewer.sender.room()
            await self._show(op.names, op.id, op.op)

    async def _set(self, op: wire.SetParameters) -> None:
        if not op.parameters:
            return
        async with self._turn:
            await self._place.parameters.set(op.parameters, self._viewer.access, lambda why: self._complain(op.op, why))
            if op.id is not None:
                await self._show([parameter.name for parameter in op.parameters], op.id, op.op)

    async def _show(self, names: Sequence[str], id: str | None, op: str) -> None:
        found = await self._place.parameters.get(names, self._viewer.access, lambda why: self._complain(op, why))
        self._tell(found, id)

    def _tell(self, parameters: Sequence[dict[str, Any]], id: str | None = None) -> None:
        answer: dict[str, Any] = {"op": "parameterValues", "parameters": list(parameters)}
        if id is not None:
            answer["id"] = id
        self._viewer.sender.text(wire.dumps(answer))

    def _complain(self, op: str, why: str) -> None:
        self._viewer.complain(op, "", InvalidOperation(op, why))

    async def _fetch(self, op: wire.FetchAsset) -> None:
        async with self._turn:
            await self._viewer.sender.room()
            try:
                content = await asyncio.to_thread(self._place.assets.read, op.uri)
            except AssetRefused as error:
                self._viewer.fault_log.note(op.op, "", error)
                self._viewer.sender.binary(wire.asset_error(op.request_id, str(error)))
                return
            self._viewer.sender.binary(wire.asset_found(op.request_id, content))

    # ── changes of parameters ──────────────────────────────────────────────────────────────────────────────────

    def watch(self, op: wire.WatchParameters) -> None:
        """Begin or end to tell of changes. Raises ``InvalidOperation`` for too many parameters."""
        if not op.on:
            self.watched.difference_update(op.names)
        elif len(self.watched | set(op.names)) > VIEWER_PARAMETERS_WATCHED:
            raise InvalidOperation(op.op, f"a viewer watches {VIEWER_PARAMETERS_WATCHED} parameters at most")
        else:
            self.watched.update(op.names)
        self._place.watch_parameters()

    def changed(self, name: str, value: Any) -> None:
        """Tell a change of a parameter, if the viewer watches it, once it has read what waits for it."""
        if name in self.watched and self._place.parameters.may_read(name, self._viewer.access):
            self._changed[name] = shown_parameter(name, value)

    def tell_changes(self) -> None:
        """Tell the changes that wait."""
        if self._changed:
            changed, self._changed = self._changed, {}
            self._tell(list(changed.values()))

    async def close(self) -> None:
        """Give up what is under way: the viewer is gone."""
        self.watched.clear()
        await self._chores.close()
