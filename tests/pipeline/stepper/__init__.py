"""Tests of steppers."""
