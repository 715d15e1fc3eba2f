"""The host's side of samplers."""
