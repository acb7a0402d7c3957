#version 330 core
out vec4 color;
void main() {
    int id = gl_PrimitiveID / 2 + 1;
    color = vec4(vec3(id & 255, (id >> 8) & 255, (id >> 16) & 255) / 255.0, 1.0);
}
