"""Type hashes against those that ROS 2 Jazzy and ROS 1 announce."""

from __future__ import annotations

import pytest

from ropeway.types import TypeRegistry

RIHS01 = {
    "std_msgs/msg/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "rmw_dds_common/msg/Gid": "ab6f21cfbb0a6dbb837161e1110c2051a2850ed9f9c53944d7115d9bcebedf71",
    "rmw_dds_common/msg/ParticipantEntitiesInfo": "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
    "service_msgs/msg/ServiceEventInfo": "41bcbbe07a75c9b52bc96bfd5c24d7f0fc0a08c0cb7921b3373c5732345a6f45",
    "rcl_interfaces/msg/ParameterEvent": "043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
    "example_interfaces/msg/WString": "32033e06d9dfe5468c5d6e1dc8b7a23c8910bad071cfd4e151a951d580e68dd8",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/srv/Empty": "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
    "example_interfaces/action/Fibonacci": "9508051da1ea4658de144b09bd0690ff3de52104683d847aed764d2915906f51",
}

MD5 = {
    "std_msgs/String": "992ce8a1687cec8c8bd883ec73ca41d1",
    "std_msgs/Header": "2176decaecbce78abc3b96ef049fabed",
    "geometry_msgs/Twist": "9f195f881246fdfa2798d1d3eebca84a",
    "sensor_msgs/Image": "060021388200f6f0f447d0fcd9c64743",
    "sensor_msgs/Imu": "6a62c6daae103f4ff57a132d6f95cec2",
    "sensor_msgs/PointCloud2": "1158d486dd51d683ce2f1be655c3c181",
    "tf2_msgs/TFMessage": "94810edda583a504dfda3829e70d7eec",
}


@pytest.mark.parametrize("name", RIHS01)
def test_rihs01(name: str) -> None:
    """Type hashes are those of ROS 2, also where char is used, for services and for actions."""
    assert TypeRegistry("jazzy").hash(name) == f"RIHS01_{RIHS01[name]}"


@pytest.mark.parametrize("distro", ["noetic", "jazzy"])
@pytest.mark.parametrize("name", MD5)
def test_md5(name: str, distro: str) -> None:
    """MD5 sums are those of ROS 1, whether the definitions come from ROS 1 or ROS 2."""
    assert TypeRegistry(distro).md5(name) == MD5[name]
