"""What nodes on rmw_zenoh show and attach."""

from __future__ import annotations

from typing import Final

from fuzz.target import Target
from ropeway.networks.zenoh import attachment, qos_text, tokens

__all__ = ["TARGETS"]

_HASH: Final = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
_NAMED: Final = b"\x0fsequence_number%b\x10source_timestamp%b\x0asource_gid\x10%b" % (bytes(8), bytes(8), bytes(16))


def _token(data: bytes) -> None:
    found = tokens.parse_token(data.decode("utf-8", "replace"))
    if found is not None:
        assert tokens.parse_token(str(found)) == found
        assert len(tokens.gid_of(str(found))) == attachment.GID_BYTES
        assert isinstance(found.gateway, str)


def _profile(data: bytes) -> None:
    found = qos_text.parse_qos(data.decode("utf-8", "replace"))
    if found is not None:
        assert qos_text.parse_qos(qos_text.qos_text(found)) is not None


def _attachment(data: bytes) -> None:
    found = attachment.parse(data)
    if found is not None:
        assert attachment.parse(attachment.pack(*found)) == found


def _tokens() -> list[bytes]:
    node = "@ros2_lv/0/a1b2/0/0/NN/%/%/talker"
    endpoint = f"@ros2_lv/0/a1b2/0/7/MP/%/%ns/talker/%ns%t/std_msgs::msg::dds_::String_/{_HASH}/2:1:,7:,:,:,,"
    return [node.encode(), endpoint.encode(), f"{endpoint}/backends:cpu:".encode()]


TARGETS: Final = {
    "zenoh-tokens": Target(_token, (), _tokens, (b"%", b"@ros2_lv/", b"::dds_::", b",:", b"/%ropeway%~")),
    "zenoh-profiles": Target(_profile, (), lambda: [b"2:1:2,5:0,5:3,0:1,9,9", b"::,10:,:,:,,"], (b"9223372036", b",:")),
    "zenoh-attachments": Target(_attachment, (), lambda: [attachment.pack(1, 2, bytes(16)), _NAMED], (b"\x10",)),
}
