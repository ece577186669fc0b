"""What draws the scenes of the detection application: one module a renderer."""
