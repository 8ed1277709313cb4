"""What all else stands on: vectors, the sector and its images, quantities, files, status, the machine."""
