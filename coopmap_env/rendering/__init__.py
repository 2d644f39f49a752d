"""Pictures of planar and field episodes, and the window that shows them."""
