"""What a fitted swarm means: forces, kernels, force maps, influence, latents."""
