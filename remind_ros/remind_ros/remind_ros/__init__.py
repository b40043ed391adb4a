"""remind-jax in ROS 2: identities of objects in `vision_msgs/Detection2DArray`."""
