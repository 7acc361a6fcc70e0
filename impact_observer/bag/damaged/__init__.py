"""What can still be read of a bag that is damaged."""
