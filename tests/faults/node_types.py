"""What the robots of these tests serve and use."""

SERVICE, ACTION = "std_srvs/srv/Trigger", "example_interfaces/action/Fibonacci"
