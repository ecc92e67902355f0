"""The interfaces of rosbridge itself: its messages about clients, and the services of rosapi.

Programs that ask rosapi for the details of ``rosapi_msgs`` or read ``/connected_clients`` find them here, as they
would where rosbridge is installed. Written from the documented fields.
"""

from __future__ import annotations

from typing import Final

__all__ = ["ROSBRIDGE_INTERFACES"]

_TYPEDEFS: Final = "string type\n---\nTypeDef[] typedefs\n"
_CHANGED: Final = "bool successful\nstring reason\n"

ROSBRIDGE_INTERFACES: Final[dict[str, str]] = {
    "rosapi_msgs/msg/TypeDef": (
        "string type\nstring[] fieldnames\nstring[] fieldtypes\nint32[] fieldarraylen\nstring[] examples\n"
        "string[] constnames\nstring[] constvalues\n"
    ),
    "rosapi_msgs/srv/ActionFeedbackDetails": _TYPEDEFS,
    "rosapi_msgs/srv/ActionGoalDetails": _TYPEDEFS,
    "rosapi_msgs/srv/ActionResultDetails": _TYPEDEFS,
    "rosapi_msgs/srv/ActionType": "string action\n---\nstring type\n",
    "rosapi_msgs/srv/DeleteParam": f"string name\n---\n{_CHANGED}",
    "rosapi_msgs/srv/GetActionServers": "---\nstring[] action_servers\n",
    "rosapi_msgs/srv/GetParam": f"string name\nstring default_value\n---\nstring value\n{_CHANGED}",
    "rosapi_msgs/srv/GetParamNames": "---\nstring[] names\n",
    "rosapi_msgs/srv/GetROSVersion": "---\nuint8 version\nstring distro\n",
    "rosapi_msgs/srv/GetTime": "---\nbuiltin_interfaces/Time time\n",
    "rosapi_msgs/srv/HasParam": "string name\n---\nbool exists\n",
    "rosapi_msgs/srv/Interfaces": "---\nstring[] interfaces\n",
    "rosapi_msgs/srv/MessageDetails": _TYPEDEFS,
    "rosapi_msgs/srv/NodeDetails": "string node\n---\nstring[] subscribing\nstring[] publishing\nstring[] services\n",
    "rosapi_msgs/srv/Nodes": "---\nstring[] nodes\n",
    "rosapi_msgs/srv/Publishers": "string topic\n---\nstring[] publishers\n",
    "rosapi_msgs/srv/ServiceNode": "string service\n---\nstring node\n",
    "rosapi_msgs/srv/ServiceProviders": "string service\n---\nstring[] providers\n",
    "rosapi_msgs/srv/ServiceRequestDetails": _TYPEDEFS,
    "rosapi_msgs/srv/ServiceResponseDetails": _TYPEDEFS,
    "rosapi_msgs/srv/ServiceType": "string service\n---\nstring type\n",
    "rosapi_msgs/srv/Services": "---\nstring[] services\n",
    "rosapi_msgs/srv/ServicesForType": "string type\n---\nstring[] services\n",
    "rosapi_msgs/srv/SetParam": f"string name\nstring value\n---\n{_CHANGED}",
    "rosapi_msgs/srv/Subscribers": "string topic\n---\nstring[] subscribers\n",
    "rosapi_msgs/srv/TopicType": "string topic\n---\nstring type\n",
    "rosapi_msgs/srv/Topics": "---\nstring[] topics\nstring[] types\n",
    "rosapi_msgs/srv/TopicsAndRawTypes": "---\nstring[] topics\nstring[] types\nstring[] typedefs_full_text\n",
    "rosapi_msgs/srv/TopicsForType": "string type\n---\nstring[] topics\n",
    "rosbridge_msgs/msg/ConnectedClient": "string ip_address\nbuiltin_interfaces/Time connection_time\n",
    "rosbridge_msgs/msg/ConnectedClients": "ConnectedClient[] clients\n",
}
"""Full names and definition texts."""
