float principled_dielectric(float ior, float c)
{
    float excess = (ior - 1.0) * (ior + 1.0), total = sqrt(excess + c * c) + c, less = excess / total;
    float a = less / total, b = (c * total - 1.0) / (c * less + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

float principled_masked(float cosine, float a)
{
    float c = max(cosine, LEAST);
    return 1.0 / (c + sqrt(a * a + (1.0 - a * a) * c * c));
}

float principled_diffuse(Pair p, float roughness, float flatness)
{
    float at_i = schlick_weight(p.cos_i), at_o = schlick_weight(p.cos_o), back = 2.0 * roughness * square(p.cos_d);
    float rough = (1.0 - 0.5 * at_i) * (1.0 - 0.5 * at_o) + back * (at_i + at_o + at_i * at_o * (back - 1.0));
    float bent = 0.5 * back - 1.0;
    float flatter = (1.0 + bent * at_i) * (1.0 + bent * at_o);
    flatter = 1.25 * (flatter * (1.0 / (p.cos_i + p.cos_o) - 0.5) + 0.5);
    return (rough + flatness * (flatter - rough)) / PI;
}

float principled_clearcoat(Pair p, float gloss)
{
    float a2 = square(0.1 - 0.099 * gloss);
    float facets = (1.0 + p.tan2_h) / (a2 + p.tan2_h) * (a2 - 1.0) / (PI * log(a2));
    float shadowing = 4.0 * p.cos_i * p.cos_o * principled_masked(p.cos_i, 0.25) * principled_masked(p.cos_o, 0.25);
    return 0.25 * facets * shadowing * schlick(0.04, p.cos_d);
}

vec3 principled(Pair p, vec3 base_color, float metallic, float roughness, float specular, float spec_tint, float sheen,
                float sheen_tint, float clearcoat, float clearcoat_gloss, float flatness)
{
    float luminance = dot(base_color, vec3(0.212671, 0.715160, 0.072169)), fifth = schlick_weight(p.cos_d);
    vec3 tint = luminance > 0.0 ? base_color / luminance : vec3(1.0);
    float rest = 1.0 - metallic, eta = 2.0 / (1.0 - sqrt(0.08 * specular)) - 1.0, a = max(square(roughness), 0.001);
    vec3 f0 = tint * square((eta - 1.0) / (eta + 1.0));
    vec3 metal = base_color + (vec3(1.0) - base_color) * fifth, tinted = f0 + (vec3(1.0) - f0) * fifth;
    vec3 fresnel = metallic * metal + rest * (1.0 - spec_tint) * principled_dielectric(eta, p.cos_d)
        + rest * spec_tint * tinted;
    float facets = square((1.0 + p.tan2_h) / (a * a + p.tan2_h)) * a * a / PI;
    facets *= principled_masked(p.cos_i, a) * principled_masked(p.cos_o, a);
    return rest * (base_color * principled_diffuse(p, roughness, flatness)
                   + sheen * mix(vec3(1.0), tint, sheen_tint) * fifth)
        + fresnel * facets + clearcoat * principled_clearcoat(p, clearcoat_gloss);
}
