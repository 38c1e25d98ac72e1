"""Rovers, obstacles and sensors on pymunk. Moves arrays of states; knows no circuit."""
