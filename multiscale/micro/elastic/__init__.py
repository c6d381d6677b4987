"""Elastic cells on meshes that follow a periodic height map."""
