"""Keeps the clients that watch the store now, bounded per address, so that one does not take the places of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ropeway.limits import WATCHERS_PER_ADDRESS
from ropeway.listener.authentication import given_token
from ropeway.listener.http import HttpRequest
from ropeway.listener.lobby import network_of
from ropeway.listener.presence import ip_address
from ropeway.listener.store_watcher import StoreWatcher

__all__ = ["Watchers"]


class Watchers:
    """The watchers of one server."""

    def __init__(self) -> None:
        self._watchers: dict[StoreWatcher, str] = {}  # and the address that counts for each, if any
        self._unknown: Counter[str] = Counter()  # those that show no credentials, by address

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._watchers)

    def __iter__(self) -> Iterator[StoreWatcher]:
        """Iterate over the current watchers; any of them may leave meanwhile."""
        return iter(list(self._watchers))

    def full(self, request: HttpRequest) -> str:
        """Return why there is no room for another such watcher, ``""`` if there is."""
        if self._unknown[_sender(request)] < WATCHERS_PER_ADDRESS or _is_known(request):
            return ""
        return f"{WATCHERS_PER_ADDRESS} watchers without a token came from this address, and no more may come"

    def add(self, watcher: StoreWatcher) -> None:
        """Count one that begins."""
        request = watcher.request
        sender = "" if request is None or _is_known(request) else _sender(request)
        self._watchers[watcher] = sender
        if sender:
            self._unknown[sender] += 1

    def discard(self, watcher: StoreWatcher) -> None:
        """Forget one that is over. Harmless twice."""
        sender = self._watchers.pop(watcher, "")
        if sender:
            self._unknown[sender] -= 1
            if not self._unknown[sender]:
                del self._unknown[sender]


def _is_known(request: HttpRequest) -> bool:
    return bool(request.certificate or given_token(request))


def _sender(request: HttpRequest) -> str:
    return network_of(ip_address(request.peer))
