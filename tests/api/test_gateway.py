"""A gateway within a program."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import ropeway
from ropeway import ConfigError, ConnectFailed
from ropeway.gateway.config.config import parse
from tests.api.conftest import new_network


@pytest.mark.parametrize("form", ["dict", "file", "text path", "model"])
async def test_forms(form: str, network: str, tmp_path: Path) -> None:
    """A gateway runs what a dict, a file or a model says, and its clients reach its graph."""
    config = {"gateway": {"name": "g", "graphs": [network], "listen": ["ws://127.0.0.1:0"]}}
    path = tmp_path / "gateway.json"
    path.write_text(json.dumps(config))
    given = {"dict": config, "file": path, "text path": str(path), "model": parse(config)}[form]
    async with ropeway.open_gateway(given) as gateway:  # type: ignore[arg-type]
        assert gateway.name == "g"
        assert gateway.status()["listen"][0]["port"] == gateway.ports[0]
        gateway.reload()
        async with ropeway.open(network) as here, here.publisher("/a", "std_msgs/String", qos="latched") as publisher:
            publisher.publish({"data": "hi"})
            async with ropeway.open(f"ws://127.0.0.1:{gateway.ports[0]}") as client, client.subscribe("/a") as reader:
                assert (await reader.receive(timeout_s=20))["data"] == "hi"
    await gateway.close()


async def test_one_of_many(network: str, tmp_path: Path) -> None:
    """One gateway of a document for many is chosen by its name; without one, the names are told."""
    document = {"gateways": {"robot": {"gateway": {"graphs": [network], "listen": []}}, "cloud": {}}}
    path = tmp_path / "fleet.json"
    path.write_text(json.dumps(document))
    async with ropeway.open_gateway(document, part="robot") as gateway:
        assert gateway.name == "robot"
    async with ropeway.open_gateway(path, part="robot") as gateway:
        assert gateway.name == "robot"
    with pytest.raises(ConfigError, match="robot, cloud"):
        await ropeway.open_gateway(document)


async def test_remotes() -> None:
    """The list of remotes that the paper has is a configuration, too."""
    far, near = new_network(), new_network()
    async with ropeway.open_gateway({"gateway": {"graphs": [far], "listen": ["ws://127.0.0.1:0"]}}) as server:
        remote = {
            "address": f"ws://127.0.0.1:{server.ports[0]}",
            "publish": [{"name": "/a", "type": "std_msgs/String"}],
        }
        async with ropeway.open_gateway({"gateway": {"graphs": [near]}, "remotes": [remote]}) as gateway:
            assert [route["name"] for route in gateway.status()["routes"]] == ["/a"]
            async with (
                ropeway.open(near) as here,
                ropeway.open(far) as there,
                here.publisher("/a", "std_msgs/String") as up,
                there.subscribe("/a", timeout_s=20) as reader,
            ):
                await up.wait_for_subscribers(timeout_s=20)
                up.publish({"data": "hi"})
                assert (await reader.receive(timeout_s=20))["data"] == "hi"


async def test_mistakes() -> None:
    """A configuration with faults tells them all, and a port that is taken is an error."""
    with pytest.raises(ConfigError) as caught:
        await ropeway.open_gateway({"gateway": {"graphs": ["dds:999"], "listen": 5}})
    assert len(caught.value.problems) == 2
    with pytest.raises(ConfigError):
        await ropeway.open_gateway("/nothing/here.json")
    async with ropeway.open_gateway({"gateway": {"graphs": [new_network()], "listen": ["ws://127.0.0.1:0"]}}) as first:
        taken = {"gateway": {"graphs": [new_network()], "listen": [f"ws://127.0.0.1:{first.ports[0]}"]}}
        with pytest.raises(ConnectFailed):
            await ropeway.open_gateway(taken)
