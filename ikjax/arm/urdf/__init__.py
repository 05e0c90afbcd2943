"""Reading URDF files strictly: XML, the chain to the tool, mimic joints, grippers at its end."""
