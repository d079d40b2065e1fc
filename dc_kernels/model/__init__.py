"""What exists: fields of arrays, settings, builder, shapes, checks."""
