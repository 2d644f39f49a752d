"""What a view in the 2-D (planar) environment would observe."""
