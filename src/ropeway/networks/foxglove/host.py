"""Say what the parts of a viewer's session may know of it, and a session of its server."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.hub.hub import View
    from ropeway.listener.authorization import Access
    from ropeway.networks.foxglove.assets import Assets
    from ropeway.networks.foxglove.channels import Catalogue, SchemaWriter
    from ropeway.networks.foxglove.parameters import ParameterSource
    from ropeway.networks.foxglove.sender import ViewerSender
    from ropeway.networks.foxglove.settings import FoxgloveSettings

__all__ = ["Place", "ViewerHost"]


class ViewerHost(Protocol):
    """Serves one viewer; ``ViewerSession`` does so."""

    peer_name: str
    access: Access
    view: View
    sender: ViewerSender
    settings: FoxgloveSettings
    writer: SchemaWriter
    fault_log: FaultLog
    requests_bytes: int
    """The bytes of the viewer's requests that are under way."""

    def complain(self, kind: str, name: str, error: object) -> None:
        """Count and log something that the viewer did wrong, and tell it."""
        ...


class Place(Protocol):
    """Holds what all viewers of a server share; ``FoxgloveServer`` does so."""

    settings: FoxgloveSettings
    writer: SchemaWriter
    catalogue: Catalogue
    parameters: ParameterSource
    assets: Assets
    call_timeout_s: float

    @property
    def greeting(self) -> bytes:
        """The operation that each viewer gets first."""
        ...

    def watch_parameters(self) -> None:
        """See again which parameters viewers watch."""
        ...

    def offers(self, capability: str) -> bool:
        """Return whether viewers may use this part of the protocol."""
        ...

    def check_offered(self, capability: str, op: str) -> None:
        """Raise ``InvalidOperation`` for an operation of a part of the protocol that is left out here."""
        ...
