"""From a checked recipe to the record: one image through the stages, many images, uncertainty."""
