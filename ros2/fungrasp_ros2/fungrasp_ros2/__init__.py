"""ROS 2 for fungrasp. Only the modules that run in ROS import rclpy, and only when they are used."""
