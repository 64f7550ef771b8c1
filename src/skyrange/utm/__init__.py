"""UAS traffic management: the contract of flight approvals, their messages, and the services that answer."""
