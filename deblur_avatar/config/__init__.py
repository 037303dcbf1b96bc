"""Parameters: `params.yaml`, read strictly; each class stands beside what it configures."""
