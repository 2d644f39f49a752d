"""``python -m coopmap``."""

from coopmap_env.cli import main

main()
