"""The rosbridge v2 protocol and what Ropeway adds to it, without I/O: bytes in, objects out, and back."""

from ropeway.networks.rosbridge.protocol.codec import (
    BINARY,
    ENCODING_NUMBERS,
    ENCODINGS,
    Frame,
    decode_msg,
    decode_publish_msg,
    decode_value,
    encode_msg,
    encode_op,
    encode_publish,
    encode_value,
    encoding_name,
    unpack_png,
)
from ropeway.networks.rosbridge.protocol.dialect import (
    ROPEWAY,
    ROPEWAY_SUBPROTOCOL,
    ROSBRIDGE,
    ROSGW,
    Dialect,
    by_subprotocol,
    detect,
)
from ropeway.networks.rosbridge.protocol.fragment import Defragmenter, Fragmenter
from ropeway.networks.rosbridge.protocol.frames import JsonAssembler, loads
from ropeway.networks.rosbridge.protocol.ops import Op, dumps, parse, present
from ropeway.networks.rosbridge.protocol.records import Arrival, RecordReader, RecordWriter

__all__ = [
    "BINARY",
    "ENCODINGS",
    "ENCODING_NUMBERS",
    "ROPEWAY",
    "ROPEWAY_SUBPROTOCOL",
    "ROSBRIDGE",
    "ROSGW",
    "Arrival",
    "Defragmenter",
    "Dialect",
    "Fragmenter",
    "Frame",
    "JsonAssembler",
    "Op",
    "RecordReader",
    "RecordWriter",
    "by_subprotocol",
    "decode_msg",
    "decode_publish_msg",
    "decode_value",
    "detect",
    "dumps",
    "encode_msg",
    "encode_op",
    "encode_publish",
    "encode_value",
    "encoding_name",
    "loads",
    "parse",
    "present",
    "unpack_png",
]
