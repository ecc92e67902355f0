"""Bounds what peers may send: every limit on counts, sizes, depth and time, with its unit and its reason.

A limit belongs here if somebody on a network can run into it: a client, a node, another gateway, a member of the
overlay. What operators choose (sizes of messages, numbers of clients, memory) is in the configuration instead.
``docs/limits.md`` lists all of them; a test compares the two.
"""

from __future__ import annotations

from typing import Final

# ── Names and texts ────────────────────────────────────────────────────────────────────────────────────────────────

NAME_CHARACTERS: Final = 256
"""A name of a topic, service, action, node or parameter. DDS bounds names likewise; a longer one is refused unread."""

TYPE_NAME_CHARACTERS: Final = 256
"""The name of a type. The longest in the standard distributions has 57 characters."""

FRAME_PREFIX_CHARACTERS: Final = 128
"""A prefix of coordinate frames, put before their names or taken away: the name of a robot."""

ID_CHARACTERS: Final = 1_024
"""The id of an operation, which is kept until it is answered or taken back. Clients put the longest names in it."""

PATTERN_CHARACTERS: Final = 256
"""A pattern for names: as long as a name."""

SHOWN_TEXT_CHARACTERS: Final = 500
"""The part of a peer's error text that is logged or passed on."""

PARAMETER_TEXT_CHARACTERS: Final = 1_024
"""A text of a client that is read as YAML, as the value of a parameter. A longer one stands for itself."""

PARAMETER_BRACKETS: Final = 16
"""Opening brackets in such a text. The values of parameters have one; each that stays open costs more than the last."""

# ── Quality of service ─────────────────────────────────────────────────────────────────────────────────────────────

QOS_DEPTH_SAMPLES: Final = 10_000
"""Samples that one writer, reader or history keeps. DDS allocates 8 bytes for each at the first sample."""

DEPTH_PER_CLIENT_SAMPLES: Final = 200_000
"""The depths above 100 of all topics that one client publishes, together: twenty of the deepest. Others get 100."""

# ── Definitions of messages ────────────────────────────────────────────────────────────────────────────────────────

DEFINITION_CHARACTERS: Final = 256 << 10
"""The text of one definition with all that it contains. Large ones, with comments, have 50,000."""

DEFINITION_FIELDS: Final = 2_000
"""Fields and constants of one definition with all that it contains, each of which costs 0.1 ms and 8 KiB in generated
code. The most in the standard distributions is 113."""

DEFINITION_NESTING: Final = 64
"""Messages that stand one in another. Python's own limit on nesting in generated code is at 200."""

FIXED_PART_BYTES: Final = 64 << 20
"""The fixed part of any type, also of those in the operator's own files: as much as the largest message. Texts, truth
values in arrays, and messages count for 64 bytes each, which they take when they are read."""

FIXED_ARRAY_BYTES: Final = 1 << 20
"""The fixed part of a told type with all that it contains, which an empty message has as well: a small image. A larger
type is named in a file of the operator's."""

FIXED_ARRAY_OBJECTS: Final = 65_536
"""Texts, truth values in arrays, and messages in the fixed part of a told type."""

DEFINITIONS_PER_CONNECTION: Final = 512
"""Definitions that one client may tell. A robot with everything installed has about 300 types."""

DEFINITIONS_PER_GATEWAY: Final = 4_096
"""Definitions that all clients together may tell; they are forgotten with the client that told them."""

DEFINITIONS_ASKED: Final = 4_096
"""Types that nodes are asked about, and requests that are remembered. A robot with everything installed has 300."""

DESCRIPTION_TRIES: Final = 3
"""How often a node is asked for the definition of a type before it is believed not to tell."""

FIELDS_PER_CONNECTION: Final = 10_000
"""Fields and constants in all definitions that one client may tell. 300 types have about 3,000."""

FIELDS_PER_GRAPH: Final = 50_000
"""Fields and constants in all definitions that the publishers and remotes of one graph may tell."""

# ── Operations of a rosbridge client ───────────────────────────────────────────────────────────────────────────────

TOPICS_PER_CLIENT: Final = 800
"""Topics that one client may publish, and as many that it may read (17 KiB each over DDS). Large robots have 600."""

IDS_PER_TOPIC: Final = 1_024
"""Registrations, each with an id of its own, of one topic by one client."""

REMEMBERED_PUBLISH_IDS: Final = 1_024
"""Ids of messages of one topic of one client that are remembered, where the client asks to drop repeated ones."""

CALLS_PER_CLIENT: Final = 1_024
"""Calls of one client that are under way."""

SERVICES_PER_CLIENT: Final = 400
"""Services that one client may offer. Each takes 36 KiB on a DDS network; a large robot has 300."""

CALLS_PER_OFFERED_SERVICE: Final = 1_024
"""Calls under way of one service that a client offers."""

GOALS_PER_CLIENT: Final = 512
"""Goals of one client that are under way. Each takes 20 KiB where the client carries them out as well."""

ACTIONS_PER_CLIENT: Final = 100
"""Actions that one client may offer. Each takes 135 KiB on a DDS network; Nav2 has 12."""

GOALS_PER_OFFERED_ACTION: Final = 1_024
"""Goals under way of one action that a client offers."""

LINGERING_CLIENTS: Final = 256
"""Clients that left whose topics are kept a while. Above, the first of them to leave is forgotten."""

WAITING_OPERATIONS: Final = 256
"""Operations of one client that wait for their turn. Above, its socket is not read."""

WAITING_OPERATIONS_BYTES: Final = 256 << 10
"""The same in bytes as they came. What they say may take 26 times as much in memory while they wait."""

WAITING_ANSWERS: Final = 1_024
"""Answers and calls that wait for the link to one client. Above, its socket is not read until half have gone."""

SEARCHES_PER_CLIENT: Final = 16
"""Services and actions that one client uses and nobody is known to serve, which are looked for at a time: each takes
up to 170 KiB on a DDS network while it is looked for."""

THROTTLED_MESSAGES: Final = 100
"""Messages of one throttled topic that wait for one client, whatever `queue_length` it asks for."""

THROTTLED_BYTES: Final = 16 << 20
"""Bytes of one throttled topic that wait for one client. Above, the oldest go."""

LONGEST_THROTTLE_MS: Final = 1e9
"""The longest `throttle_rate`: eleven days."""

LONGEST_CALL_S: Final = 3_600.0
"""The longest `timeout` of a call that is waited for; what "for ever" means."""

# ── Frames and messages ────────────────────────────────────────────────────────────────────────────────────────────

NESTED_CONTAINERS: Final = 128
"""Lists and objects within each other in JSON and CBOR. ROS messages have about ten."""

UNPACKED_BYTES: Final = 13 << 20
"""The memory that the values of any CBOR or JSON may take."""

UNPACKED_PER_BYTE: Final = 14
"""The memory that the values of long CBOR or JSON may take for each of its bytes. Points take 12, poses with their
headers 13; what takes more (a megabyte of small maps of whole numbers) goes as ``cbor-raw`` or in several messages."""

UNFINISHED_MESSAGES: Final = 64
"""Messages in parts of one connection of which more is still to come."""

UNFINISHED_MESSAGE_S: Final = 30.0
"""Time between two parts of a message in records. After that the message is given up."""

FRAGMENTS: Final = 65_536
"""Fragments of one operation. Fragments of 1 KiB carry the largest message; smaller ones help nobody."""

ORIGINS_PER_CONNECTION: Final = 4_096
"""Publishers that a gateway tells apart on one connection in one direction."""

HTTP_HEAD_BYTES: Final = 16 << 10
"""The head of an HTTP request."""

UNREAD_ANSWERS_BYTES: Final = 16 << 20
"""Answers that a peer does not read. Above, its connection is closed."""

UNREAD_S: Final = 10.0
"""How long a peer may read nothing while more than `UNREAD_STATUS_BYTES` wait for it; then its connection is closed."""

UNREAD_STATUS_BYTES: Final = 1 << 20
"""The bytes that a peer has not read, above which it is sent no more notices and no more feedback."""

# ── ROS 1 ──────────────────────────────────────────────────────────────────────────────────────────────────────────

ROS1_CALLERS: Final = 64
"""Connections of others that call a node by XML-RPC. Above, the one that has been silent longest is dropped."""

ROS1_NEWCOMERS: Final = 256
"""Connections to a node's topics and services that have not said yet what they want. Above, the oldest is dropped."""

ROS1_PUBLISHERS_PER_TOPIC: Final = 256
"""Publishers of one topic that are read, each over a connection of its own. Whoever reaches a node can tell it more."""

# ── The overlay ────────────────────────────────────────────────────────────────────────────────────────────────────

OVERLAY_MESSAGE_BYTES: Final = 64 << 20
"""One message of the overlay, unpacked, where no configuration says otherwise (``gateway.max_message_bytes``)."""

OVERLAY_BATCH_BYTES: Final = 1 << 20
"""The size of all other messages of a packet beside the largest, unpacked. Senders put 256 KiB in one."""

OVERLAY_MESSAGES_PER_PACKET: Final = 4_096
"""Messages in one packet. Senders put 256 in one."""

OVERLAY_SESSION_READERS: Final = 8
"""Readers of a publisher to which it proves each packet one by one. For more a signature costs less and is shorter."""

OVERLAY_WAYS: Final = 8
"""Links by which a gateway may send the same packet."""

OVERLAY_LINK_WAITING_BYTES: Final = 4 << 20
"""Packets that wait for one of several links of the overlay. Above, copies of the next are left out there."""

OVERLAY_COPY_BYTES: Final = 4 << 10
"""A packet that comes by a second session, too: commands and the like, sealed."""

OVERLAY_HISTORY_BYTES: Final = 64 << 20
"""One answer with messages that a reader missed, beside the last of them."""

OVERLAY_ROUTED_BYTES: Final = 136 << 20
"""One message that a router puts together and passes on: an answer with messages that a reader missed, sealed."""

OVERLAY_HELD_BYTES: Final = 256 << 20
"""Messages that wait in one gateway for a key, or for what came before them, of all publishers together."""

OVERLAY_HELD_BYTES_PER_PUBLISHER: Final = 64 << 20
"""The same of one publisher: the largest message fits."""

OVERLAY_HELD_MESSAGES: Final = 4_096
"""Messages of one publisher that wait for what came before them."""

OVERLAY_WAITING_BYTES: Final = 128 << 20
"""Messages of one name that were opened and wait for the event loop. Above, the oldest go."""

OVERLAY_WAITING_NOTES_BYTES: Final = 16 << 20
"""Notes and requests of one kind that wait for the event loop. Above, the oldest go."""

OVERLAY_NOTE_BYTES: Final = 2 << 20
"""One note between gateways. A change of 500 advertisements with the longest names has 1.5 MiB."""

OVERLAY_NOTE_ITEMS: Final = 8_192
"""Values in one note: each costs up to 100 bytes, whatever it is. A change of the largest size has 4,000."""

OVERLAY_REQUEST_ITEMS: Final = 32_768
"""Values in one request or answer between gateways. The largest history has 10,000 messages."""

OVERLAY_NESTED_CONTAINERS: Final = 8
"""Lists and maps within each other in what gateways tell each other. They have four."""

OVERLAY_REQUESTS: Final = 4_096
"""Requests of other gateways that are under way."""

OVERLAY_REQUESTS_BYTES: Final = 256 << 20
"""The same in bytes."""

OVERLAY_CHANNELS: Final = 4_096
"""Sealed channels that other gateways opened. The one that was not used for longest goes."""

OVERLAY_CHANNELS_PER_MEMBER: Final = 128
"""The same of one member: twice as many as it may have gateways."""

OVERLAY_LIST_BYTES: Final = 128 << 20
"""All that a gateway advertises, as it is told."""

OVERLAY_ADVERTISEMENTS_PER_GATEWAY: Final = 100_000
"""Topics, services and users of both that one gateway advertises. 5,000 robots behind one have 50,000."""

OVERLAY_GATEWAYS_PER_MEMBER: Final = 64
"""Gateways that run with the certificate of one member. One is usual, and two for a moment when it starts again."""

OVERLAY_STRANGERS: Final = 64
"""Gateways that are being asked who they are."""

OVERLAY_POOL_GATEWAYS: Final = 256
"""Gateways that are members of one group. Each has a publisher or a client of its own for every name of the group."""

OVERLAY_METADATA_CHARACTERS: Final = 1_024
"""Each of the texts that go into a global name beside it."""

OVERLAY_CRL_BYTES: Final = 4 << 20
"""A revocation list: 100,000 certificates."""

OVERLAY_FILE_BYTES: Final = 16 << 20
"""A bundle, a request, a key or a list in a file. The largest revocation list has a third of it in PEM."""

OVERLAY_REMEMBERED_BYTES: Final = 16 << 20
"""Answers of one service that are kept for requests that come twice."""

# ── rmw_zenoh ──────────────────────────────────────────────────────────────────────────────────────────────────────

ZENOH_TOKEN_CHARACTERS: Final = 4_096
"""A token by which a node or an endpoint shows itself. The longest names make one of 1,500."""

ZENOH_TOKENS: Final = 100_000
"""Tokens that are kept of one network. 500 nodes have some 15,000; more are counted and not listed."""

ZENOH_TOKENS_BYTES: Final = 64 << 20
"""Tokens that wait for the event loop. Above, the oldest go, and all tokens are asked for again."""

ZENOH_HASHES_PER_NAME: Final = 8
"""Hashes of a type under which one endpoint shows itself: one for each distribution that has another layout of it."""

ZENOH_READ_BYTES: Final = 32 << 20
"""Messages of one topic that wait for the event loop. Above, the oldest go."""

ZENOH_UNSENT_BYTES: Final = 32 << 20
"""Messages of one publisher that wait for the network. Above, the oldest go; of best effort topics, above the depth."""

ZENOH_REQUESTS_BYTES: Final = 64 << 20
"""Requests of one service, or answers to one client, that wait for the event loop. Above, the oldest go."""

ZENOH_REQUESTS: Final = 1_024
"""Requests of one service that are carried out at a time. More are answered at once, with the default response."""

ZENOH_MESSAGE_BYTES: Final = 256 << 20
"""One message of the network, which Zenoh puts together."""

# ── MQTT ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

MQTT_TOPIC_BYTES: Final = 65_535
"""The name of a topic, or a filter: as long as MQTT can say. One whose ROS name is too long is not listed."""

MQTT_TOPICS: Final = 10_000
"""Topics of a broker that are listed because a message was seen. Of more, those seen longest ago are forgotten."""

MQTT_TOPIC_AGE_S: Final = 3_600.0
"""Time after its last message for which a topic is listed."""

MQTT_PRESENCES: Final = 1_000
"""Other gateways whose announcements at a broker are read."""

MQTT_PRESENCE_BYTES: Final = 256 << 10
"""The announcement of one gateway: 2,000 topics."""

MQTT_PRESENCE_ENDPOINTS: Final = 2_000
"""Topics in one announcement."""

MQTT_KEPT_TOPICS: Final = 1_024
"""Topics of one filter whose last values are kept for late joiners. Of more, the oldest goes."""

MQTT_KEPT_BYTES: Final = 64 << 20
"""The same in bytes, but for one value."""

MQTT_PEEKS: Final = 1_024
"""Topics of which it is found out whether a broker keeps a value. Of more, that is learnt once they are read."""

MQTT_UNSENT_BYTES: Final = 64 << 20
"""Messages of all topics that wait for a broker. Above, further ones are dropped until it has taken some."""

MQTT_UNSENT_RELIABLE_BYTES: Final = 1 << 20
"""The same of one reliable topic, but for one message. Of others that are large, the newest alone waits."""

MQTT_IN_FLIGHT: Final = 64
"""Messages that a broker has not acknowledged, at most; fewer where the broker says so."""

MQTT_IN_FLIGHT_BYTES: Final = 16 << 20
"""The same in bytes, but for one message."""

MQTT_UNREAD_BYTES: Final = 64 << 20
"""Messages that were received in one turn of the event loop. Above, the rest waits with the broker."""

# ── The log ────────────────────────────────────────────────────────────────────────────────────────────────────────

LOG_BURST_LINES: Final = 60
"""Lines that one place in the code may log at once; what peers do is logged by a few dozen places."""

LOG_LINES_PER_S: Final = 0.2
"""Lines that one place in the code may log on average; the next line tells how many were left out."""

LOG_LINE_CHARACTERS: Final = 2_000
"""A line of the log, but for tracebacks."""

# ── Connections that are not let in yet ────────────────────────────────────────────────────────────────────────────

PENDING_CONNECTIONS: Final = 1_024
"""Connections of all listeners on which a TLS handshake, a request or a login is still to come. Above, the oldest is
dropped, so that silent ones keep nobody out."""

PENDING_PER_ADDRESS: Final = 100
"""Such connections from one address (an IPv6 network of 64 bits counts as one). Above, its oldest is dropped."""

HANDSHAKES_AT_ONCE: Final = 64
"""TLS handshakes of all listeners that are under way, as each takes 90 kB; others wait for their turn."""

HANDSHAKE_TURN_S: Final = 1.0
"""Time that a TLS handshake has for sure; a longer one is given up where others wait for their turn."""

LOGIN_S: Final = 10.0
"""Time in which an IoRT node has to say who it is, where that is asked."""

WRONG_TOKENS_PER_CONNECTION: Final = 3
"""Wrong tokens on one connection of a node. The connection is closed after them."""

WRONG_TOKENS: Final = 10
"""Wrong tokens from one address that are looked at at once; one more every `WRONG_TOKEN_S`. Then it is locked out."""

WRONG_TOKEN_S: Final = 10.0
"""See `WRONG_TOKENS`. A gateway that is set up with a wrong token tries less often than that."""

FIRST_LOCKOUT_S: Final = 10.0
"""Time for which tokens of an address are refused unread after too many wrong ones. It doubles each time."""

LONGEST_LOCKOUT_S: Final = 300.0
"""The longest such time: whoever has the right token again waits no longer than that."""

WRONG_TOKEN_DELAY_S: Final = 0.1
"""How much later the answer to a wrong token is for each wrong one before it from the same address, up to 1 s."""

ADDRESSES: Final = 4_096
"""Addresses whose wrong tokens are remembered. Above, the one that was quiet longest is forgotten."""

# ── Foxglove viewers ───────────────────────────────────────────────────────────────────────────────────────────────

VIEWER_ITEMS_PER_OPERATION: Final = 4_096
"""Channels, subscriptions or parameters in one operation of a viewer. A large robot has 600 topics."""

VIEWER_PARAMETER_CHARACTERS: Final = 513
"""A parameter with its node before it: two names and a dot."""

VIEWER_PARAMETERS_WATCHED: Final = 4_096
"""Parameters whose changes one viewer is told. A robot with Nav2 has about 2,000."""

VIEWER_QUESTIONS: Final = 32
"""Requests of one viewer for parameters and files that are not answered yet."""

VIEWER_STATUSES: Final = 50
"""Complaints that a viewer is told at once; the next ones follow at `VIEWER_STATUSES_PER_S`, all are counted."""

VIEWER_STATUSES_PER_S: Final = 5.0
"""See `VIEWER_STATUSES`. A person cannot read more."""

ASSET_URI_CHARACTERS: Final = 1_024
"""The name of a file that a viewer fetches."""

ASSET_BYTES: Final = 64 << 20
"""A file that a viewer fetches: as much as the largest message. Meshes of robots have up to 20 MiB."""

# ── Readers of the store, and IoRT nodes ───────────────────────────────────────────────────────────────────────────

WATCHER_UNREAD_BYTES: Final = 4 << 20
"""The bytes that a watcher of the store has not read. Above, its connection is closed."""

WATCHERS_PER_ADDRESS: Final = 100
"""Watchers of the store from one address (an IPv6 network of 64 bits counts as one) that show neither a token nor a
certificate."""

WATCHER_SILENCE_S: Final = 30.0
"""Time for which a watcher of the store may take nothing of what waits for it."""

PATTERNS_PER_NODE: Final = 64
"""Subscriptions of one node with wildcards, each of which is tried on every value."""

NODE_PACKET_S: Final = 30.0
"""Time in which a packet of a node has to come whole."""

NODE_SILENCE_S: Final = 30.0
"""Time for which a node may say nothing that has said by a ping that it will. Of others TCP is asked, every 30 s."""

NODE_UNREAD_BYTES: Final = 256 << 10
"""The bytes that a node has not read. Above, values wait, the newest of each topic, and no more is read from it."""

NODE_WAITING_BYTES: Final = 16 << 20
"""Values that wait for one node. Above, those of other topics go."""

ENDPOINTS_PER_NODE: Final = 4_096
"""Topics that one node publishes or subscribes to."""

BROUGHT_TOPICS_PER_NODE: Final = 10_000
"""The same of a node that brings values of a time when the server was away: as many as a local server keeps."""

# ── Groups ──────────────────────────────────────────────────────────────────────────────────────────────────────────

LINK_SENT_AGAIN_BYTES: Final = 1 << 20
"""The last messages of a topic, or packets of the overlay, that may go again by another link where one may be cut."""

HEDGED_BYTES: Final = 32 << 20
"""Messages of one topic that are kept until they are answered. Above, no second member is asked for them."""

STATE_LEASE_S: Final = 3_600.0
"""Time for which a robot's gateway may give a machine of its group a state."""

STATE_CHARACTERS: Final = 256
"""A state, and the name of its group."""

HELD_STATES: Final = 256
"""States that robots' gateways have given a member of the overlay. Above, the oldest is forgotten."""

# ── The control API ────────────────────────────────────────────────────────────────────────────────────────────────

CONTROL_CONNECTIONS: Final = 128
"""Connections to the control API at a time: a dashboard has one or two for each gateway. More are closed unread."""

CONTROL_HEAD_BYTES: Final = 16 << 10
"""The head of a request: as long as at the listeners."""

CONTROL_BODY_BYTES: Final = 16 << 20
"""The body of a request. A configuration with 1,000 routes has 400 KiB."""

CONTROL_BODIES_BYTES: Final = 64 << 20
"""The bodies of all requests that are read or worked on at a time: more have to wait for their turn."""

CONTROL_REQUEST_S: Final = 10.0
"""Time in which a request has to come whole, head and body."""

CONTROL_READER_BYTES: Final = 1 << 20
"""Events that wait for one reader of the stream. A slower one is dropped: it can ask again from where it was."""

CONTROL_READER_S: Final = 30.0
"""Time for which a reader of the stream may take nothing of what is sent to it, comments included."""

CONTROL_EVENT_BYTES: Final = 16 << 10
"""The data of one event. A longer one is told without its data."""

CONTROL_EVENTS_KEPT: Final = 1_000
"""Events that a gateway remembers, for readers that come later."""

CONTROL_ANSWER_BYTES: Final = 16 << 20
"""An answer that our client takes, as the dashboard does. The status of 1,000 routes has 500 KiB."""

CONTROL_STREAM_LINE_BYTES: Final = 8 << 20
"""A line of a stream of events that our client takes: a message of a topic may hold a picture."""

CONTROL_STORE_VALUES: Final = 2_000
"""Values of the store that one answer lists: the newest."""

LOOKED_AT_TOPICS: Final = 64
"""Topics that are read for people who look at them, and as many that they publish on."""

DIGEST_VALUES: Final = 2_000
"""Fields and elements of a message that are shown to people."""

DIGEST_TEXT_CHARACTERS: Final = 1_000
"""A text in a message that is shown to people."""

PICTURE_BYTES: Final = 1 << 20
"""A compressed image that is shown to people as it is; a larger one is not."""

JOURNAL_ENTRIES: Final = 20_000
"""Changes that a journal remembers. Above, the oldest are forgotten, a tenth at a time."""

JOURNAL_BYTES: Final = 256 << 20
"""The configurations in a journal, compressed, and each that is the same once."""

# ── The dashboard ──────────────────────────────────────────────────────────────────────────────────────────────────

DASHBOARD_SESSIONS: Final = 1_000
"""Browsers that are logged in at a time. Above, the one that came first has to log in again."""

DASHBOARD_WATCHES: Final = 1_000
"""Gateways that are watched, counted once for each token that is shown to them."""

DASHBOARD_LOGIN_BYTES: Final = 8 << 10
"""The form of a login."""

DASHBOARD_ROWS: Final = 500
"""Rows of a table that a page shows; it says how many there are."""

DASHBOARD_CONNECTIONS: Final = 512
"""Connections of browsers at a time; a page has a few. More are answered 503."""

# ── The audit log ───────────────────────────────────────────────────────────────────────────────────────────────────

AUDIT_QUEUE_BYTES: Final = 8 << 20
"""Notes that wait to be written to the audit log, with payloads that are not hashed yet: images of a moment. What does
not fit is counted, and the log says so."""

AUDIT_WINDOW_S: Final = 10.0
"""Time in which the same again becomes no further entry of the audit log, but a number in one."""

AUDIT_ENTRIES_PER_SENDER: Final = 100
"""Different entries of one kind that one address gets in the audit log within that time. The rest is one entry that
says how many there were. Some 10 MB an hour, whatever a client tries."""

AUDIT_SENDERS: Final = 256
"""Addresses that get entries of their own within that time; further ones share one."""

AUDIT_KEPT: Final = 1_000
"""Entries of the audit log that are kept in memory, to be read, and to be written once a full disk has room again."""

AUDIT_SCAN_BYTES: Final = 32 << 20
"""The part of the audit log that one request looks through: a tenth of a second. The answer says where to go on."""

AUDIT_ANSWER_ENTRIES: Final = 5_000
"""Entries in one answer."""

AUDIT_NAME_CHARACTERS: Final = 256
"""A name in an entry of the audit log, which a client may have chosen."""

AUDIT_TEXT_CHARACTERS: Final = 500
"""A reason in an entry of the audit log: as much as is logged of a peer's error."""

REPORTED_REASONS: Final = 32
"""Reasons for drops that a far gateway reports of one topic: there are a dozen."""

REPORTED_REASON_CHARACTERS: Final = 100
"""One of these reasons, which people read."""

# ── Topics and services over REST ───────────────────────────────────────────────────────────────────────────────────

REST_REQUESTS: Final = 128
"""Requests for topics and services, streams included, that are under way at a listener. More are refused (503)."""

REST_HEAD_BYTES: Final = 16 << 10
"""The head of a request: as long as at the listeners."""

REST_BODY_BYTES: Final = 16 << 20
"""The body of a request: a message or the arguments of a call, as JSON."""

REST_REQUEST_S: Final = 10.0
"""Time in which a request has to come whole."""

REST_UNREAD_BYTES: Final = 256 << 10
"""The bytes of a stream that its reader has not read. Above, newer messages take the place of those that wait."""

REST_READER_S: Final = 30.0
"""Time for which a reader may take nothing of what is sent to it."""

REST_TOPICS: Final = 256
"""Topics that are published or read for requests at a time. Above, those not used for longest go."""

REST_IDLE_S: Final = 30.0
"""Time for which a topic is read on after the last request for it, so that the next gets its value at once."""

REST_WAIT_S: Final = 30.0
"""The longest that a request may wait for the first message of a topic."""

CLIENT_DELAY_TOPICS: Final = 512
"""Topics of clients whose delays are counted apart; a histogram is 14 lines of metrics. What is beyond shares one."""

FIELD_PATH_CHARACTERS: Final = 256
"""A path to a field, as mappings of ``gateway.http`` have; names of fields are far shorter."""

FIELD_PATH_STEPS: Final = 32
"""Steps of such a path: deeper than messages are."""


# ── Recordings ─────────────────────────────────────────────────────────────────────────────────────────────────────

RECORDING_WAITING_BYTES: Final = 256 << 20
"""Messages that wait for the disk. Above, what comes is left out, and counted: robots need their memory elsewhere."""

RECORDING_UNPACKED_BYTES: Final = 64 << 30
"""The files of a recording that were compressed whole, unpacked together: an hour of all sensors of a car. A few
kilobytes of a hostile one would unpack to as much as the disk has."""

RECORDING_DISK_BYTES: Final = 1 << 30
"""Left free on a disk on which such files are unpacked: other programs need it, too."""

RECORDED_CLIP_S: Final = 600.0
"""The longest clip: a condition that flickers, or somebody who triggers all the time, begins another then."""

RECORDED_MESSAGE_BYTES: Final = 256
"""Counted for each message that waits, beside its bytes, so that a flood of small ones is bounded, too."""
