"""What people use: case files, runs, batches, results, pictures, reports."""
