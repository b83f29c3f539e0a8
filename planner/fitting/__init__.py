"""Fits of lines, planes, circles, spheres, cylinders and cones to points, with their uncertainty."""
