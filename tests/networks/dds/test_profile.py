"""The configuration of a domain."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds.profile import Profile, make_profile


def ours(profile: Profile) -> ElementTree.Element:
    """The domain element of our own part."""
    root = ElementTree.fromstring(profile.xml.split("</CycloneDDS>")[0] + "</CycloneDDS>")
    domain = root.find("Domain")
    assert domain is not None
    return domain


def test_transport() -> None:
    """Fast DDS gets datagrams that fit its socket buffer, and withdrawals that it reads; our own buffers are large."""
    domain = ours(make_profile("dds:0", None, {}))
    assert domain.findtext("General/MaxMessageSize") == "8192B"
    assert domain.findtext("General/FragmentSize") == "8000B"
    assert domain.findtext("Internal/Watermarks/WhcHigh") == "16MB"
    assert domain.findtext("Internal/GenerateKeyhash") == "true"
    buffer = domain.find("Internal/SocketReceiveBufferSize")
    assert buffer is not None
    assert buffer.attrib == {"min": "default", "max": "8MB"}
    assert domain.findtext("Discovery/MaxAutoParticipantIndex") == "119"
    assert domain.find("General/Interfaces") is None
    assert domain.find("Discovery/Peers") is None


@pytest.mark.parametrize("interface", ["lo", "127.0.0.1"])
def test_loopback(interface: str) -> None:
    """On the loopback interface discovery goes by unicast, as it has no multicast."""
    profile = make_profile("dds:0", interface, {})
    domain = ours(profile)
    assert domain.findtext("General/AllowMulticast") == "false"
    assert [p.attrib for p in domain.findall("Discovery/Peers/Peer")] == [{"Address": "127.0.0.1"}]
    assert domain.find("General/Interfaces/NetworkInterface") is not None
    assert profile.interface == interface


@pytest.mark.parametrize("env", [{"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}])
def test_localhost_only(env: dict[str, str]) -> None:
    """ROS's variables that keep a node on its machine keep us there."""
    assert make_profile("dds:0", None, env) == make_profile("dds:0", "lo", {})


def test_a_library_that_does_not_answer_from_loopback() -> None:
    """Such a library keeps its choice of interface where ROS's range is this machine; what was asked for stays."""

    def made(interface: str | None, **env: str) -> Profile:
        return make_profile("dds:0", interface, env, answers_from_loopback=False)

    ranged = made(None, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    domain = ours(ranged)
    assert ranged.interface == ""
    assert domain.find("General/Interfaces") is None
    assert domain.findtext("General/AllowMulticast") == "false"
    assert [p.attrib for p in domain.findall("Discovery/Peers/Peer")] == [{"Address": "127.0.0.1"}]
    assert made("lo") == made(None, ROS_LOCALHOST_ONLY="1") == make_profile("dds:0", "lo", {})


def test_interface_of_cyclonedds_uri(tmp_path: Path) -> None:
    """An interface that CYCLONEDDS_URI selects, inline or in a file, is not named twice; another one is refused."""

    def selecting(element: str) -> str:
        interfaces = f"<General><Interfaces>{element}</Interfaces></General>"
        return f"<CycloneDDS><Domain>{interfaces}</Domain></CycloneDDS>"

    inline = selecting('<NetworkInterface name="lo"/>')
    file = tmp_path / "cyclone.xml"
    file.write_text(inline)
    for uri in (inline, f"file://{file}", f"<CycloneDDS/>,{file}"):
        for interface, env in ((None, {"ROS_LOCALHOST_ONLY": "1"}), ("lo", {}), ("127.0.0.1", {}), (None, {})):
            domain = ours(make_profile("dds:0", interface, {**env, "CYCLONEDDS_URI": uri}))
            assert domain.find("General/Interfaces") is None
            assert [p.attrib["Address"] for p in domain.findall("Discovery/Peers/Peer")] == ["127.0.0.1"]
    other = selecting('<NetworkInterface autodetermine="true"/>')
    with pytest.raises(GraphUnavailable, match="take the interface out of one of the two"):
        make_profile("dds:0", "lo", {"CYCLONEDDS_URI": other})
    tag = "<CycloneDDS><!-- <NetworkInterface name='eth7'/> --></CycloneDDS>"
    assert ours(make_profile("dds:0", "lo", {"CYCLONEDDS_URI": tag})).find("General/Interfaces") is not None


def test_static_peers() -> None:
    """ROS's static peers are asked, on the interface that leads to them."""
    env = {"ROS_STATIC_PEERS": "192.0.2.7; robot.example", "ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}
    domain = ours(make_profile("dds:0", None, env))
    peers = [p.attrib["Address"] for p in domain.findall("Discovery/Peers/Peer")]
    assert peers == ["192.0.2.7", "robot.example", "127.0.0.1"]
    assert domain.find("General/Interfaces") is None


def test_discovery_off() -> None:
    """With discovery off nobody is asked and nobody finds us."""
    env = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": "192.0.2.7"}
    domain = ours(make_profile("dds:0", None, env))
    assert domain.find("Discovery/Peers") is None
    assert (domain.findtext("Discovery/Tag") or "").startswith("ros_discovery_off_")


def test_bad_range() -> None:
    """A misspelt range is named, with the valid ones."""
    with pytest.raises(GraphUnavailable, match="LOCALHOST"):
        make_profile("dds:0", None, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOKALHOST"})


def test_user_configuration_comes_last() -> None:
    """CYCLONEDDS_URI is applied after ours, so that it wins."""
    assert make_profile("dds:0", None, {"CYCLONEDDS_URI": "file:///a.xml"}).xml.endswith("</CycloneDDS>,file:///a.xml")


@pytest.mark.parametrize("interface", ["nosuch0", "192.0.2.254", "2001:db8::1"])
def test_bad_interface(interface: str) -> None:
    """An interface or address that this machine does not have is refused, with what to do."""
    with pytest.raises(GraphUnavailable, match=r"leave it out") as caught:
        make_profile("dds:3", interface, {})
    assert interface in str(caught.value)
