"""Pictures, video and the HTML page of a grasp. Rendering needs no GPU, display or OpenGL."""
