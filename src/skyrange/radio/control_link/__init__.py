"""Control links over the air: Wi-Fi and cellular channels of `gcs` links, with the medium's losses and noise."""
