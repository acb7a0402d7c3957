"""From BRDF values to radiance: quadrature, the sparse product, its cache, shadows."""
