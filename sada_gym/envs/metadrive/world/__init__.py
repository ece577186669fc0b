"""MetaDrive's world: its one engine, and drives in it."""
