"""The ROS 2 package: launch files and executables. The program itself is the Python package ``ropeway``."""

from setuptools import setup

setup(
    name="ropeway_ros",  # that of the Python package is taken
    version="0.1.0",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ropeway"]),
        ("share/ropeway", ["package.xml"]),
        ("share/ropeway/launch", ["launch/rosbridge_websocket_launch.xml"]),
    ],
    scripts=["scripts/rosbridge_websocket", "scripts/rosapi_node"],
    install_requires=["setuptools"],
    zip_safe=False,
    license="Apache-2.0",
    description="Starts Ropeway's rosbridge server from ROS 2 launch files",
)
