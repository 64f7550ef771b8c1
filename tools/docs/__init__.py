"""Generated parts of the documentation, and the measurements that its pages show."""
