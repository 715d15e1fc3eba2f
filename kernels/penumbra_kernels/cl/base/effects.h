// Bits of a node's rejected_in: what a rejected sample's path had met, so that the receipt can say where NaNs come from.
#define EFFECT_LENS 1u
#define EFFECT_MOTION 2u
#define EFFECT_AREA_LIGHT 4u
#define EFFECT_DELTA_LIGHT 8u
#define EFFECT_ENVIRONMENT 16u
#define EFFECT_GLOSS 32u
#define EFFECT_TRANSMISSION 64u
#define EFFECT_TEXTURE 128u
#define EFFECT_DIFFUSE 256u
