// G, so that the albedo of the first term is A (1 + r G / pi)
float eon_gain(float cosine)
{
    float c = clamp(cosine, LEAST, 1.0), s2 = max(1.0 - c, 1e-12) * (1.0 + c), s = sqrt(s2);
    return s * (atan(s, c) - s * c) + 2.0 / 3.0 * (s * c * (1.0 + s + s2) / (1.0 + s) - s);
}

vec3 eon(Pair p, vec3 albedo, float roughness)
{
    float r = roughness, above = 2.0 * square(p.cos_d) - p.cos_i * p.cos_o;
    float slant = above > 1.0 ? 1.0 + r * (above - 1.0) / max(p.cos_i, p.cos_o) : 1.0 - r + r * above;
    float height = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * PI)) * r);
    float mean = height * (1.0 + (2.0 / 3.0 - 28.0 / (15.0 * PI)) * r);
    float lost_i = max(1.0 - height * (1.0 + r / PI * eon_gain(p.cos_i)), 0.0);
    float lost_o = max(1.0 - height * (1.0 + r / PI * eon_gain(p.cos_o)), 0.0);
    float again = lost_i * lost_o / max(1.0 - mean, 1e-7);
    vec3 multiple = albedo * albedo * mean / (vec3(1.0) - albedo * (1.0 - mean));
    return (albedo * height * slant + multiple * again) / PI;
}
