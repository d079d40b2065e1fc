"""Bodies that have come to rest, which no stage looks at until something disturbs them."""
