"""What ROS 2 needs to find Ropeway: the program itself is the Python package ``ropeway``."""
