"""Interfaces that every ROS 2 has and the definitions of the distributions leave out: services, actions, examples.

``INTERFACES`` maps a full name to its definition text, written here from the documented fields.
"""

from __future__ import annotations

from typing import Final

from ropeway.types.rosbridge import ROSBRIDGE_INTERFACES

__all__ = ["INTERFACES"]

_SET_BOOL: Final = "bool data\n---\nbool success\nstring message\n"
_TRIGGER: Final = "---\nbool success\nstring message\n"

INTERFACES: Final[dict[str, str]] = {
    "action_msgs/srv/CancelGoal": (
        "GoalInfo goal_info\n---\n"
        "int8 ERROR_NONE=0\nint8 ERROR_REJECTED=1\nint8 ERROR_UNKNOWN_GOAL_ID=2\nint8 ERROR_GOAL_TERMINATED=3\n"
        "int8 return_code\nGoalInfo[] goals_canceling\n"
    ),
    "composition_interfaces/srv/ListNodes": "---\nstring[] full_node_names\nuint64[] unique_ids\n",
    "composition_interfaces/srv/LoadNode": (
        "string package_name\nstring plugin_name\nstring node_name\nstring node_namespace\nuint8 log_level\n"
        "string[] remap_rules\nrcl_interfaces/Parameter[] parameters\nrcl_interfaces/Parameter[] extra_arguments\n"
        "---\nbool success\nstring error_message\nstring full_node_name\nuint64 unique_id\n"
    ),
    "composition_interfaces/srv/UnloadNode": "uint64 unique_id\n---\nbool success\nstring error_message\n",
    "diagnostic_msgs/srv/AddDiagnostics": "string load_namespace\n---\nbool success\nstring message\n",
    "diagnostic_msgs/srv/SelfTest": "---\nstring id\nbyte passed\nDiagnosticStatus[] status\n",
    "example_interfaces/action/Fibonacci": "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n",
    "example_interfaces/srv/AddTwoInts": "int64 a\nint64 b\n---\nint64 sum\n",
    "example_interfaces/srv/SetBool": _SET_BOOL,
    "example_interfaces/srv/Trigger": _TRIGGER,
    "lifecycle_msgs/srv/ChangeState": "Transition transition\n---\nbool success\n",
    "lifecycle_msgs/srv/GetAvailableStates": "---\nState[] available_states\n",
    "lifecycle_msgs/srv/GetAvailableTransitions": "---\nTransitionDescription[] available_transitions\n",
    "lifecycle_msgs/srv/GetState": "---\nState current_state\n",
    "nav_msgs/srv/GetMap": "---\nOccupancyGrid map\n",
    "nav_msgs/srv/GetPlan": (
        "geometry_msgs/PoseStamped start\ngeometry_msgs/PoseStamped goal\nfloat32 tolerance\n---\nPath plan\n"
    ),
    "nav_msgs/srv/LoadMap": (
        "string map_url\n---\n"
        "uint8 RESULT_SUCCESS=0\nuint8 RESULT_MAP_DOES_NOT_EXIST=1\nuint8 RESULT_INVALID_MAP_DATA=2\n"
        "uint8 RESULT_INVALID_MAP_METADATA=3\nuint8 RESULT_UNDEFINED_FAILURE=255\nOccupancyGrid map\nuint8 result\n"
    ),
    "nav_msgs/srv/SetMap": (
        "OccupancyGrid map\ngeometry_msgs/PoseWithCovarianceStamped initial_pose\n---\nbool success\n"
    ),
    "rcl_interfaces/srv/DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors\n",
    "rcl_interfaces/srv/GetLoggerLevels": "string[] names\n---\nLoggerLevel[] levels\n",
    "rcl_interfaces/srv/GetParameterTypes": "string[] names\n---\nuint8[] types\n",
    "rcl_interfaces/srv/GetParameters": "string[] names\n---\nParameterValue[] values\n",
    "rcl_interfaces/srv/ListParameters": (
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth\n---\nListParametersResult result\n"
    ),
    "rcl_interfaces/srv/SetLoggerLevels": "LoggerLevel[] levels\n---\nSetLoggerLevelsResult[] results\n",
    "rcl_interfaces/srv/SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results\n",
    "rcl_interfaces/srv/SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result\n",
    "sensor_msgs/srv/SetCameraInfo": "CameraInfo camera_info\n---\nbool success\nstring status_message\n",
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": _SET_BOOL,
    "std_srvs/srv/Trigger": _TRIGGER,
    "tf2_msgs/action/LookupTransform": (
        "string target_frame\nstring source_frame\nbuiltin_interfaces/Time source_time\n"
        "builtin_interfaces/Duration timeout\nbuiltin_interfaces/Time target_time\nstring fixed_frame\nbool advanced\n"
        "---\ngeometry_msgs/TransformStamped transform\nTF2Error error\n---\n"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",  # the store of noetic has none
    "tf2_msgs/srv/FrameGraph": "---\nstring frame_yaml\n",
    "type_description_interfaces/srv/GetTypeDescription": (
        "string type_name\nstring type_hash\nbool include_type_sources true\n---\nbool successful\n"
        "string failure_reason\nTypeDescription type_description\nTypeSource[] type_sources\n"
        "KeyValue[] extra_information\n"
    ),
    "visualization_msgs/srv/GetInteractiveMarkers": "---\nuint64 sequence_number\nInteractiveMarker[] markers\n",
    **ROSBRIDGE_INTERFACES,
}

_NUMBERS: Final = ("Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64")
for _name in ("Bool", "Byte", "Char", "String", "WString", *_NUMBERS):
    INTERFACES[f"example_interfaces/msg/{_name}"] = f"{_name.lower()} data\n"
for _name in ("Byte", *_NUMBERS):
    INTERFACES[f"example_interfaces/msg/{_name}MultiArray"] = f"MultiArrayLayout layout\n{_name.lower()}[] data\n"
INTERFACES["example_interfaces/msg/Empty"] = ""
INTERFACES["example_interfaces/msg/MultiArrayDimension"] = "string label\nuint32 size\nuint32 stride\n"
INTERFACES["example_interfaces/msg/MultiArrayLayout"] = "MultiArrayDimension[] dim\nuint32 data_offset\n"
