vec3 ward_anisotropic(Pair p, vec3 specular, float roughness_x, float roughness_y, float rotation)
{
    vec2 a = vec2(roughness_x, roughness_y), slope = in_the_grain(p.slope, rotation) / a;
    float height = inversesqrt(p.cos_i) * inversesqrt(p.cos_o) / (4.0 * PI * a.x * a.y);
    return specular * (exp(-dot(slope, slope)) * height);
}
