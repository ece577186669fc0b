"""Photographs that lie in packages of others, under conditions of camera and weather."""
