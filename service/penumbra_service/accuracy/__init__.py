"""What accuracy costs, beyond one job's own account: quotes, comparisons of samplers, merged renders."""
