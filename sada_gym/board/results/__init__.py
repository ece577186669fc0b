"""What results say: figures with intervals and ranks, tables, charts."""
