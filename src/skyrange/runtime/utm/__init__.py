"""UTM services as processes: a USS, a DSS or an authorization service of F3548 on HTTP, in real time."""
