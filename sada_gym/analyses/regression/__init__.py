"""Failures of a run as a regression suite: do they come back, and does anything break newly?"""
