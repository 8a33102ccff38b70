"""The ray tracer for machines without an accelerator: MJX's pictures, by the processor's cores."""
