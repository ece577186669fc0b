"""What a run leaves for people: worlds.csv, thumbnails, and report.html."""
