vec3 charlie(Pair p, vec3 specular, float roughness)
{
    float log_sine = p.tan2_h < 1e-30 ? -1000.0 : 0.5 * (log(p.tan2_h) - log1p(p.tan2_h));
    float facets = exp(log_sine / roughness) * (2.0 + 1.0 / roughness) / (2.0 * PI);
    return specular * (facets * 0.25 / (p.cos_i + p.cos_o - p.cos_i * p.cos_o));
}
