"""Discovery and synchronization service (DSS): entities of the airspace, subscriptions and availabilities."""
