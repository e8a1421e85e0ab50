"""Scene files, state files and meshes that something has happened to: each is read, or refused in one sentence."""
