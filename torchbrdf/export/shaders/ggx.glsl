vec3 ggx(Pair p, vec3 specular, float roughness, float f0)
{
    float a2 = roughness * roughness;
    float facets = square((1.0 + p.tan2_h) / (a2 + p.tan2_h)) * a2 / PI;
    return specular * (facets * ggx_visibility(p, roughness) * schlick(f0, p.cos_d));
}
