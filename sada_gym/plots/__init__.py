"""Pictures of an attack."""
