"""Which triangle each pixel sees: camera, mesh, and rasterisers in software and OpenGL."""
