"""One honest evaluation for planners and learned policies alike."""
