"""What closed contacts do: impact law, position projection, clutches, persistent contact."""
