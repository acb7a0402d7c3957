const float PI = 3.14159265358979;
const float LEAST = 1e-10;

// Cosines of the directions and of the half vector's angles, and tan^2 of the latter to the normal.
struct Pair { float cos_i; float cos_o; float cos_d; float tan2_h; };

Pair pair_of(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y)
{
    vec3 H = normalize(L + V);
    vec3 h = vec3(dot(H, X), dot(H, Y), dot(H, N));
    return Pair(dot(L, N), dot(V, N), max(dot(L, H), LEAST), (h.x * h.x + h.y * h.y) / max(h.z * h.z, 1e-30));
}

float square(float x) { return x * x; }

// With all digits near 0.
float log1p(float x)
{
    return x < 0.01 ? x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x))) : log(1.0 + x);
}

float one_minus_cos_h(Pair p)
{
    float secant = sqrt(1.0 + p.tan2_h);
    return p.tan2_h / ((secant + 1.0) * secant);
}

// 1 - cos_d fifth power, and Schlick's Fresnel.
float schlick_weight(float cos_d) { float x = 1.0 - cos_d; return x * x * x * x * x; }
float schlick(float f0, float cos_d) { return f0 + (1.0 - f0) * schlick_weight(cos_d); }

// exp(-tan2_h / w^2) / cos_h^4
float beckmann_exponential(Pair p, float w) { return exp(2.0 * log1p(p.tan2_h) - p.tan2_h / (w * w)); }

// G / (cos_i cos_o) of V-shaped grooves
float v_groove(Pair p)
{
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    return min(1.0 / (i * o), 2.0 / (sqrt(1.0 + p.tan2_h) * p.cos_d * max(i, o)));
}

// G / (4 cos_i cos_o) of Smith, heights correlated, for the GGX distribution
float ggx_visibility(Pair p, float a)
{
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    float s_i = sqrt(a * a + (1.0 - a * a) * i * i), s_o = sqrt(a * a + (1.0 - a * a) * o * o);
    return 0.5 / (o * s_i + i * s_o);
}
