"""The files a user writes (recipe, rig, scene, target, data set), checked, with the place of every fault."""
