"""appd."""
