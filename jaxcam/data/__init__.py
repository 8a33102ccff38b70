"""What policies learn from: demonstrations on disk, their pictures, samples and batches."""
