"""How does an operator fly? Plans, their volumes, and the ground station that carries them out."""
