"""Your own images under attack: conditions of camera, weather and scene."""
