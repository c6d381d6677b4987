// A quarter of a strip with a hole, in mm: both planes of symmetry go through the hole.
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 40, 20, 4};
Cylinder(2) = {0, 0, -1, 0, 0, 6, 5};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
e = 1e-3;
left() = Surface In BoundingBox {-e, -e, -e, e, 20 + e, 4 + e};
front() = Surface In BoundingBox {-e, -e, -e, 40 + e, e, 4 + e};
bottom() = Surface In BoundingBox {-e, -e, -e, 40 + e, 20 + e, e};
right() = Surface In BoundingBox {40 - e, -e, -e, 40 + e, 20 + e, 4 + e};
Physical Surface("left") = {left()};
Physical Surface("front") = {front()};
Physical Surface("bottom") = {bottom()};
Physical Surface("right") = {right()};
Physical Volume("strip") = {3};
