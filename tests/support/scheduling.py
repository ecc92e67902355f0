"""Deals files to the processes of a parallel run, also after one of them has crashed."""

from __future__ import annotations

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

__all__ = ["FileScheduling"]


class FileScheduling(LoadFileScheduling):
    """Deals whole files as ``--dist loadfile`` does; a crash of a process costs the test that it ran, and no other.

    xdist's own deals every file of the crashed process again, also those that are finished, and the crashed test with
    its file. A process that is dealt a finished file has nothing to report and is never dealt another: the run hangs.
    """

    def remove_node(self, node: WorkerController) -> str | None:
        """Take a process out; return the test that it crashed in, if it did. What it had not run is dealt again."""
        dealt = self.assigned_work.pop(node)
        crashed: str | None = next((test for tests in dealt.values() for test, done in tests.items() if not done), None)
        if crashed is None:
            return None
        dealt[self._split_scope(crashed)][crashed] = True
        self.workqueue.update((file, tests) for file, tests in dealt.items() if not all(tests.values()))
        for other in self.assigned_work:
            self._reschedule(other)
        return crashed

    def schedule(self) -> None:
        """Deal what there is, to a process that came in the place of a crashed one as to the first ones: two files.

        A process runs its last test only when it knows what comes next.
        """
        late = self.collection is not None
        super().schedule()
        if late:
            for node in self.nodes:
                self._reschedule(node)

    def _reschedule(self, node: WorkerController) -> None:
        if node in self.registered_collections:  # one that has just come in the place of another asks by itself, later
            super()._reschedule(node)
