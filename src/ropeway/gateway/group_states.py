"""The states of a group's machines: told to their gateways, and entered with the parameters that belong to them.

Which machine serves is decided here, at the sender; a machine is told so over the link, beside the topics that cross,
and holds what it was told for a while, so that one whose robot is gone stands by again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from typing import Any, Final, Protocol

from ropeway.aio import timeout
from ropeway.errors import RopewayError
from ropeway.gateway.config.policy import Policies
from ropeway.gateway.config.policy_model import SERVICE, STANDBY
from ropeway.graph.base import Graph
from ropeway.graph.parameters import ParameterValue, set_parameters
from ropeway.group.state_lease import LEASE_S
from ropeway.tasks import Supervised, describe, end
from ropeway.types import TypeRegistry

__all__ = ["GroupStates"]

log = logging.getLogger("ropeway.group")

_RENEWALS: Final = 3  # of a lease within its time, so that two may be lost
_ROBOT: Final = ""
"""This gateway itself, among the machines."""

_SET_S: Final = 5.0  # for the nodes of a machine to set their parameters
_AGAIN_S: Final = 2.0  # after a node did not answer: it may have begun meanwhile


class Machines(Protocol):
    """The machines of a group, by name or address."""

    def machines(self) -> Mapping[str, Graph]:
        """Return the graphs of those that are reached."""

    def tell_state(self, name: str, state: str) -> None:
        """Tell the gateway of one its state, for ``LEASE_S``, if it takes that."""

    @property
    def current(self) -> str:
        """The one that serves."""


class GroupStates:
    """Keeps the machines of one group in their states."""

    def __init__(
        self,
        policies: Policies,
        machines: Machines,
        registry: TypeRegistry,
        *,
        group: str,
    ) -> None:
        self._policies, self._machines, self._registry = policies, machines, registry
        self._group = group
        self._entered: dict[str, str] = {}  # the state whose parameters each machine has
        self._faults: dict[str, dict[str, str]] = {}
        self._unreached: set[str] = set()  # machines with a node that did not answer
        self._to_tell, self._to_enter = asyncio.Event(), asyncio.Event()
        self._view: Graph | None = None
        self._tasks: tuple[Supervised, ...] = ()

    @property
    def barred(self) -> frozenset[str]:
        """The addresses whose state is one of the user's own: they are asked nothing."""
        return frozenset(a for a, state in self._policies.initial.items() if state not in (SERVICE, STANDBY))

    @property
    def first(self) -> str:
        """The address that serves at the start, ``""`` where the policy leaves it open."""
        return next((a for a, state in self._policies.initial.items() if state == SERVICE), "")

    def start(self, view: Graph) -> None:
        """Begin to tell; parameters of the robot itself are set on ``view``."""
        self._view = view
        self._tasks = (
            Supervised(self._tell, f"states of {self._group}").start(),
            Supervised(self._enter_all, f"parameters of states of {self._group}").start(),
        )

    def changed(self) -> None:
        """Tell at once: another machine serves now, or one has come."""
        self._to_tell.set()
        self._to_enter.set()

    def state_of(self, address: str) -> str:
        """Return the state of the machine at an address."""
        own = self._policies.initial.get(address, STANDBY)
        return own if own not in (SERVICE, STANDBY) else SERVICE if address == self._machines.current else STANDBY

    def status(self) -> dict[str, Any]:
        """Return the state of each machine, by its name or address, and what its nodes refused, as JSON."""
        names = {address: name for name, address in self._policies.machines.items()}
        return {
            names.get(address, address): {
                "address": address,
                "state": self.state_of(address),
                "refused": self._faults.get(address, {}),
            }
            for address in {**self._policies.initial, **self._machines.machines()}
        }

    async def close(self) -> None:
        """Tell no more; the leases run out."""
        await end(*self._tasks)

    async def _tell(self) -> None:
        while True:
            self._to_tell.clear()
            for name in self._machines.machines():
                self._machines.tell_state(name, self.state_of(name))
            try:
                async with timeout(LEASE_S / _RENEWALS):
                    await self._to_tell.wait()
            except TimeoutError:
                continue

    async def _enter_all(self) -> None:
        while True:
            self._to_enter.clear()
            reached = self._machines.machines()
            for name in self._entered.keys() - {*reached, _ROBOT}:
                del self._entered[name]  # it may be another machine when it comes back
                self._unreached.discard(name)
            mine = {} if self._view is None else {_ROBOT: self._view}
            await asyncio.gather(*(self._enter(name, graph) for name, graph in {**mine, **reached}.items()))
            with contextlib.suppress(TimeoutError):
                async with timeout(_AGAIN_S if self._unreached else None):
                    await self._to_enter.wait()

    async def _enter(self, address: str, graph: Graph) -> None:
        """Set the parameters of the state that a machine is in, once."""
        state = self.state_of(address) if address != _ROBOT else self._policies.mine
        if self._entered.get(address) == state and address not in self._unreached:
            return
        self._entered[address] = state
        self._unreached.discard(address)
        definition = self._policies.states.get(state)
        if definition is None:
            return
        who = address or "this gateway"
        faults: dict[str, str] = {}
        for node, values in definition.params.items():
            faults |= await self._set(address, graph, node, values)
        before, self._faults[address] = self._faults.get(address), faults
        for name, why in faults.items() if faults != before else ():
            log.warning("%s: %s enters state %s, but %s was not set: %s", self._group, who, state, name, why)
        if before and not faults:
            log.info("%s: %s has all parameters of state %s now", self._group, who, state)

    async def _set(self, address: str, graph: Graph, node: str, values: Mapping[str, ParameterValue]) -> dict[str, str]:
        """Set the parameters of a node; return why which could not be. A node that does not answer is asked again."""
        try:
            answers = await set_parameters(graph, self._registry, node, values, timeout_s=_SET_S)
        except RopewayError as error:
            self._unreached.add(address)
            return {f"{node} {name}": describe(error) for name in values}
        return {f"{node} {name}": why or "refused" for name, why in answers.items() if why is not None}
