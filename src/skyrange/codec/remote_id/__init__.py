"""Remote ID on links and over the air: link payloads, 802.11 and BLE frames, and MAVLink Open Drone ID messages."""
