vec3 ashikhmin_shirley_anisotropic(
    Pair p, vec3 specular, float exponent_x, float exponent_y, float rotation, float f0)
{
    vec2 n = vec2(exponent_x, exponent_y), slope = in_the_grain(p.slope, rotation);
    float flattening = p.tan2_h > 0.0 ? log1p(p.tan2_h) / p.tan2_h : 1.0;
    float power = exp(-0.5 * dot(n, slope * slope) * flattening) * sqrt((n.x + 1.0) * (n.y + 1.0)) / (8.0 * PI);
    return specular * (power / (p.cos_d * max(p.cos_i, p.cos_o)) * schlick(f0, p.cos_d));
}
