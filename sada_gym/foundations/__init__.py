"""What every other folder stands on: files, arrays, frames, seeds, cards, compiled kernels."""
