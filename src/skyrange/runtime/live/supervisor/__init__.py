"""Supervisor of a live range: its processes, other machines, namespaces, the merge of the records."""
