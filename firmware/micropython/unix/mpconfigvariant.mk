# Of the variant (mpconfigvariant.h) nothing is set by make.
