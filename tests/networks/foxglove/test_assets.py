"""Files that viewers fetch."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from ropeway.networks.foxglove import assets as module
from ropeway.networks.foxglove.assets import AssetRefused, Assets
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.until import until


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A directory with a package, and secrets beside it."""
    share = tmp_path / "share"
    (share / "robot" / "meshes").mkdir(parents=True)
    (share / "robot" / "meshes" / "arm.stl").write_bytes(b"solid arm")
    (share / "robot" / "my arm.png").write_bytes(b"png")
    (share / "robot" / "notes.txt").write_text("not listed")
    (share / "secret.stl").write_text("beside the packages")
    (tmp_path / "secret.stl").write_text("outside")
    (share / "robot" / "link.stl").symlink_to(tmp_path / "secret.stl")
    (share / "linked").symlink_to(tmp_path)
    os.mkfifo(share / "robot" / "pipe.stl")
    (share / "robot" / "folder.stl").mkdir()
    return share


def served(root: Path, *allowed: str) -> Assets:
    settings = FoxgloveSettings(asset_roots=(root,))
    return Assets(FoxgloveSettings(asset_roots=(root,), asset_uris=patterns(allowed)) if allowed else settings)


def test_files_of_packages(root: Path) -> None:
    """A file of a package is read by its name."""
    assert served(root).read("package://robot/meshes/arm.stl") == b"solid arm"
    assert served(root).read("package://robot/my%20arm.png") == b"png"
    assert served(root, ".*").read("package://robot/notes.txt") == b"not listed"


@pytest.mark.parametrize(
    "uri",
    [
        "package://robot/../secret.stl",
        "package://robot/meshes/../../secret.stl",
        "package://../secret.stl",
        "package://robot/%2e%2e/secret.stl",
        "package://robot/..%2fsecret.stl",
        "package://robot//meshes/arm.stl",
        "package:///robot/meshes/arm.stl",
        "package://robot/./meshes/arm.stl",
        "package://robot\\..\\secret.stl",
        "package://robot/meshes/arm.stl\0",
        "package://robot/link.stl",
        "package://linked/secret.stl",
        "package://secret.stl",
        "package://robot",
        "package://robot/",
        "package://robot/pipe.stl",
        "package://robot/folder.stl",
        "package://robot/missing.stl",
        "package://nobody/arm.stl",
        "package://robot/" + "a/" * 400 + "arm.stl",
        "package://robot/" + "a" * 300 + ".stl",
        "file:///etc/passwd",
        "http://localhost/arm.stl",
        "/etc/passwd",
        "",
    ],
)
@pytest.mark.parametrize("allowed", [(), (r"(?s).*",)], ids=["default", "all"])
def test_nothing_else(root: Path, uri: str, allowed: tuple[str, ...]) -> None:
    """Nothing but a file in a package is read, whatever patterns allow, and no answer tells where files are here."""
    with pytest.raises(AssetRefused) as refused:
        served(root, *allowed).read(uri)
    assert str(root.parent) not in str(refused.value)


def test_patterns(root: Path) -> None:
    """A file that no pattern allows is not read."""
    with pytest.raises(AssetRefused, match="asset_uri_allowlist"):
        served(root).read("package://robot/notes.txt")


def test_large_files(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is too large is refused unread."""
    monkeypatch.setattr(module, "ASSET_BYTES", 5)
    with pytest.raises(AssetRefused, match="has 9 bytes"):
        served(root).read("package://robot/meshes/arm.stl")


async def fetched(viewer: Viewer, uri: str, number: int = 5) -> tuple[int, bytes]:
    """Fetch a file, and return the status and what came."""
    viewer.send({"op": "fetchAsset", "uri": uri, "requestId": number})
    await viewer.until(lambda: viewer.binary)
    data = viewer.binary.pop()
    opcode, request, status, length = struct.unpack_from("<BIBI", data)
    assert (opcode, request) == (4, number)
    return status, data[10:] if status == 0 else data[10 : 10 + length]


async def test_fetching(dark: Sight, root: Path) -> None:
    """A viewer gets a file, or the reason why not, under the number of its request."""
    await dark.start(FoxgloveSettings(asset_roots=(root,)))
    viewer = await dark.viewer()
    assert "assets" in (await viewer.op("serverInfo"))["capabilities"]
    assert await fetched(viewer, "package://robot/meshes/arm.stl") == (0, b"solid arm")
    status, text = await fetched(viewer, "package://robot/../secret.stl", 6)
    assert (status, text.startswith(b"package://robot/../secret.stl ")) == (1, True)


async def test_without_roots(sight: Sight) -> None:
    """Without directories no files are offered, and who asks is told what is missing."""
    viewer = await sight.viewer()
    assert "assets" not in (await viewer.op("serverInfo"))["capabilities"]
    status, text = await fetched(viewer, "package://robot/meshes/arm.stl")
    assert (status, b"asset_roots" in text) == (1, True)


async def test_files_that_are_not_read(dark: Sight, root: Path) -> None:
    """Of many large files that a viewer asks for and does not take, few are held at a time, and all come in the end."""
    size = 8 << 20
    (root / "robot" / "large.stl").write_bytes(bytes(size))
    await dark.start(FoxgloveSettings(asset_roots=(root,)))
    viewer = await dark.viewer(receive_bytes=1024)
    await viewer.op("serverInfo")
    for number in range(16):
        viewer.send({"op": "fetchAsset", "uri": "package://robot/large.stl", "requestId": number})
    session = dark.session
    await until(lambda: session.sender.answers_bytes > 0)
    most = 0
    while len(viewer.binary) < 16:
        await viewer.take()
        most = max(most, session.sender.answers_bytes)
    assert most <= size + 100
    assert sorted(struct.unpack_from("<BI", data)[1] for data in viewer.binary) == list(range(16))
