"""The Gazebo program and skyrange's plugin for it: finding, examining, and the command lines that start them."""
