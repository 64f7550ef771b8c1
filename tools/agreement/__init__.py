"""Agreement of skyrange with other programs: radio engines, physics, reactions to false GNSS, and Gazebo's speed."""
