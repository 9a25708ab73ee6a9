"""What the world is: scenario files, their schema, geometry, bodies, lighting and error distributions."""
