"""The `skyrange` command as `python -m skyrange`."""

from __future__ import annotations

from skyrange.cli import main

if __name__ == "__main__":
    main()
