"""The viewer: flights as one stream of messages, and the page that shows it."""
