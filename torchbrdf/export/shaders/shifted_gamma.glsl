// acos of a cosine from 0 to 1 to single precision, which GLSL's own acos and atan need not have (Cephes' asinf); small
// errors of the angle become large ones of the shadowing.
float angle_of(float cosine)
{
    bool near = cosine > 0.5;
    float x = near ? sqrt(max(0.5 * (1.0 - cosine), 0.0)) : cosine;
    float z = x * x;
    float a = 4.2163199048e-2;
    a = ((((a * z + 2.4181311049e-2) * z + 4.5470025998e-2) * z + 7.4953002686e-2) * z + 1.6666752422e-1) * z * x + x;
    return near ? 2.0 * a : 0.5 * PI - a;
}

vec3 shifted_gamma_shadowing(float cosine, vec3 shadow, vec3 reach, vec3 steepness, vec3 onset)
{
    float theta = angle_of(cosine);
    vec3 power = steepness * log(max(vec3(theta) - onset, 1e-30) / reach);
    vec3 x = exp(min(power, 3.0));
    // e^x - 1, with all digits near 0
    vec3 risen = mix(exp(x) - 1.0, x * (1.0 + x * (0.5 + x / 6.0)), vec3(lessThan(x, vec3(0.01))));
    return max(1.0 - shadow * risen, 0.0);
}

vec3 shifted_gamma(Pair p, vec3 specular, vec3 alpha, vec3 p_tail, vec3 normalization, vec3 f0, vec3 f1, vec3 shadow,
                   vec3 reach, vec3 steepness, vec3 onset)
{
    vec3 shifted = alpha + p.tan2_h / alpha;
    vec3 facets = exp(2.0 * log1p(p.tan2_h) - shifted - p_tail * log(shifted)) * normalization;
    vec3 fresnel = max(f0 + (vec3(1.0) - f0) * schlick_weight(p.cos_d) - f1 * p.cos_d, 0.0);
    vec3 shadowing = shifted_gamma_shadowing(p.cos_i, shadow, reach, steepness, onset);
    shadowing *= shifted_gamma_shadowing(p.cos_o, shadow, reach, steepness, onset);
    return specular * facets * fresnel * shadowing / (PI * PI * max(p.cos_i * p.cos_o, 1e-13));
}
