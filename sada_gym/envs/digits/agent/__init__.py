"""The digits' classifier: network and weights."""
