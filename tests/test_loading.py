"""ropeway.loading: modules that are imported in a thread while a loop goes on."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from ropeway.loading import load, preload
from tests.support.until import until

_WAITS = """
import threading

thread = threading.current_thread()
go_on = threading.Event()
waits = True
assert go_on.wait(60)
done = True
"""


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where modules may be written that can be imported."""
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


async def test_the_loop_goes_on_meanwhile(directory: Path) -> None:
    """Whoever asks for a module, also one whose import has begun, gets it when it is whole; the loop goes on."""
    (directory / "slow_to_load.py").write_text(_WAITS)
    asking = [asyncio.create_task(load("slow_to_load"))]
    await until(lambda: hasattr(sys.modules.get("slow_to_load"), "waits"))
    asking.append(asyncio.create_task(load("slow_to_load")))
    await asyncio.sleep(0)
    assert not any(task.done() for task in asking)
    sys.modules["slow_to_load"].go_on.set()
    first, second = await asyncio.gather(*asking)
    assert first is second is sys.modules.pop("slow_to_load")
    assert first.done


async def test_what_is_there_is_there_at_once() -> None:
    """A module that was imported is returned without waiting for anything."""
    with pytest.raises(StopIteration) as returned:
        load("ropeway.errors").send(None)
    assert returned.value.value is sys.modules["ropeway.errors"]


async def test_what_cannot_be_loaded_ahead_is_left_out(directory: Path) -> None:
    """A module that is missing is an error for who asks for it, and none where modules are loaded ahead."""
    (directory / "loaded_ahead.py").write_text("")
    await preload(["no_such_module", "loaded_ahead"])
    assert sys.modules.pop("loaded_ahead")
    with pytest.raises(ModuleNotFoundError):
        await load("no_such_module")
