"""Physics of mounts on vehicles (PyBullet)."""
