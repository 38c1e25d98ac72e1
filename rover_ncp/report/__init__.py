"""What a run or a training meant, as numbers, pictures and pages."""
