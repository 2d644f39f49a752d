"""``python -m coopmap_env.cli``."""

from coopmap_env.cli import main

main()
