"""Who may fly where and when? The approval contract, its messages, and the services that answer."""
