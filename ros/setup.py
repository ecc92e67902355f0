"""The ROS 2 package: launch files, executables and ``ros2 ropeway``. The program is the Python package ``ropeway``."""

from setuptools import setup

setup(
    name="ropeway_ros",  # that of the Python package is taken
    version="0.1.0",
    packages=["ropeway_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ropeway"]),
        ("share/ropeway", ["package.xml"]),
        (
            "share/ropeway/launch",
            [
                "launch/foxglove_bridge_launch.xml",
                "launch/gateway_launch.xml",
                "launch/rosbridge_websocket_launch.xml",
            ],
        ),
    ],
    scripts=["scripts/foxglove_bridge", "scripts/gateway", "scripts/rosbridge_websocket", "scripts/rosapi_node"],
    entry_points={"ros2cli.command": ["ropeway = ropeway_ros.command:RopewayCommand"]},
    install_requires=["setuptools"],
    zip_safe=False,
    license="Apache-2.0",
    description="Starts Ropeway's gateway and rosbridge server from ROS 2",
)
