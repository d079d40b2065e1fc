// How the image of a world is cut into tiles. Macros: TILE_ROWS, TILE_COLUMNS.
#if !defined(__CUDA_ARCH__)
const int across = (columns + TILE_COLUMNS - 1) / TILE_COLUMNS;
const int world_tiles = across * ((rows + TILE_ROWS - 1) / TILE_ROWS);
#endif
