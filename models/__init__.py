"""What the robots and the field are: MJCF, datasheets, scene composition."""
