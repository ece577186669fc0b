"""What a benchmark tells its reader: tables and pictures."""
