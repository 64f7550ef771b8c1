"""UAS service supplier (USS): intents of its operators, what others share, and its requests to the DSS and to peers."""
