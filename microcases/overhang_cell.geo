// A periodic cell, in units of 10 um: a block with a closed pore, and a summit on a stem with a rim that
// overhangs. `gmsh -3 overhang_cell.geo -o overhang_cell.msh` makes the mesh of overhang_cell.toml.
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 2, 2, 1};
Cylinder(2) = {1, 1, 1, 0, 0, 0.3, 0.4};
Cylinder(3) = {1, 1, 1.3, 0, 0, 0.4, 0.7};
Sphere(6) = {1, 1, -1.4, 3};
BooleanIntersection(7) = { Volume{3}; Delete; }{ Volume{6}; Delete; };
BooleanUnion(4) = { Volume{1}; Delete; }{ Volume{2, 7}; Delete; };
Sphere(8) = {1, 1, 0.5, 0.3};
BooleanDifference(9) = { Volume{4}; Delete; }{ Volume{8}; Delete; };

e = 0.001;
left() = Surface In BoundingBox{-e, -e, -e, e, 2 + e, 1 + e};
right() = Surface In BoundingBox{2 - e, -e, -e, 2 + e, 2 + e, 1 + e};
front() = Surface In BoundingBox{-e, -e, -e, 2 + e, e, 1 + e};
back() = Surface In BoundingBox{-e, 2 - e, -e, 2 + e, 2 + e, 1 + e};
bottom() = Surface In BoundingBox{-e, -e, -e, 2 + e, 2 + e, e};
pore() = Surface In BoundingBox{0.7 - e, 0.7 - e, 0.2 - e, 1.3 + e, 1.3 + e, 0.8 + e};
Periodic Surface{right()} = {left()} Translate{2, 0, 0};
Periodic Surface{back()} = {front()} Translate{0, 2, 0};
top() = Abs(Boundary{ Volume{9}; });
top() -= {left(), right(), front(), back(), bottom(), pore()};
Physical Surface("base") = {bottom()};
Physical Surface("summits") = {top()};
Physical Volume("steel") = {9};

dome() = Surface In BoundingBox{0.3 - e, 0.3 - e, 1.5 - e, 1.7 + e, 1.7 + e, 1.6 + e};
MeshSize{ PointsOf{ Surface{dome()}; } } = 0.12;
Mesh.MeshSizeMax = 0.25;
