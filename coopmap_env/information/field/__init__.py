"""What a view in the 3-D (field) environment would observe."""
