"""Compiled code of pictures: triangles become pixels."""
