"""Images of one's own under attack: conditions of camera, weather and scene."""
